"""Tree of a state: which object is in or on which other, the goal, and the facts that only words can show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from .profile import Look, Profile, Rule
from .subject import Atom, Subject, Wanted


@dataclass
class Node:
    """An object, a thing that is not an object, or a part of an object, with its contents.

    Attributes
    ----------
    key : str
        An object's name, `#thing`, `object#part`, or `##heading`.
    title : str
    look : Look
    marks : list of str
    wants : list of pair of str and bool
        The parts of the goal about this place, and whether each holds.
    notes : list of str
        The nodes to which it is connected.
    inside, on : list of Node
        The nodes in it, and those stacked on it.
    done : bool or None
        Whether all parts of the goal that name it hold; None if the goal neither places nor marks it.
    colour : int or None
        The number of its colour.
    """

    key: str
    title: str
    look: Look
    marks: list[str] = field(default_factory=list)
    wants: list[tuple[str, bool]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    inside: list[Node] = field(default_factory=list)
    on: list[Node] = field(default_factory=list)
    done: bool | None = None
    colour: int | None = None

    @property
    def is_object(self) -> bool:
        """Whether it is an object of the task."""
        return "#" not in self.key


@dataclass(frozen=True)
class Scene:
    """A state as trees of nodes.

    Attributes
    ----------
    roots : list of Node
        The nodes that are in or on no other.
    also : list of str
        Facts that hold and are not drawn.
    goal : list of pair of str and bool
        The parts of the goal in words, and whether each holds.
    said : list of str
        The drawn facts, in words.
    """

    roots: list[Node]
    also: list[str]
    goal: list[tuple[str, bool]]
    said: list[str]


HEADING = Look(shape="panel")


def arrange(subject: Subject, profile: Profile, values: Sequence[int]) -> Scene:
    """Return the scene of a state.

    Parameters
    ----------
    subject : Subject
    profile : Profile
    values : sequence of int, shape (variables,)
        The state.
    """
    facts = subject.facts(values)
    nodes = _nodes(subject, profile)
    order = {name: number for number, name in enumerate(nodes)}
    placed = _places(subject, profile, facts, nodes)
    for key in sorted(placed, key=order.__getitem__):
        how, where = placed[key]
        (nodes[where].on if how == "on" else nodes[where].inside).append(nodes[key])
    for rule, fact in _said_by(profile.marks, facts):
        key, word = rule.of(fact)
        if key in nodes:
            nodes[key].marks.append(word)
    _colour(profile, facts, nodes)
    goal = [(say_wanted(profile, wanted), subject.holds(wanted, facts, values)) for wanted in subject.goal]
    for wanted, (_, done) in zip(subject.goal, goal, strict=True):
        _want(profile, wanted, done, nodes)
    for node in nodes.values():
        if node.done:
            node.done = all(so for wanted, (_, so) in zip(subject.goal, goal, strict=True) if wanted.names(node.key))
    _connect(subject, profile, facts, nodes)
    shown = {*profile.places, *profile.marks, *profile.links, *profile.colours, *profile.hidden}
    also = sorted(" ".join(fact) for fact in facts & subject.changing if fact[0] not in shown)
    said = [_say(profile, placed, nodes[key]) for key in nodes if key in placed or nodes[key].marks]
    if profile.guessed:
        said = sorted(" ".join(fact) for fact in facts & subject.changing if " ".join(fact) not in also)
    return Scene(_roots(subject, profile, nodes, placed), also, goal, said)


def say_wanted(profile: Profile, wanted: Wanted) -> str:
    """Return a part of the goal in words."""
    if wanted.atom is None:
        return wanted.text
    predicate = wanted.atom[0]
    rule = None if profile.guessed else profile.places.get(predicate) or profile.marks.get(predicate)
    if rule is None:
        return " ".join([*_unless(profile, wanted), *wanted.atom])
    what, where = map(profile.name, rule.of(wanted.atom))
    return " ".join([what, *_unless(profile, wanted), *_how(profile, rule.how), where])


def _unless(profile: Profile, wanted: Wanted, word: str = "not") -> list[str]:
    return [profile.texts.texts[f"drawing.{word}"]] * wanted.negated


def _how(profile: Profile, how: str) -> list[str]:
    return [profile.texts.texts[f"drawing.{how}"]] if how else []


def _said_by(rules: Mapping[str, Rule], facts: Iterable[Atom]) -> Iterator[tuple[Rule, Atom]]:
    """Yield the facts with a rule, in the order of the rules."""
    by_predicate: dict[str, list[Atom]] = {}
    for fact in sorted(facts):
        by_predicate.setdefault(fact[0], []).append(fact)
    for predicate, rule in rules.items():
        yield from ((rule, fact) for fact in by_predicate.get(predicate, ()))


def _nodes(subject: Subject, profile: Profile) -> dict[str, Node]:
    """Return a node for each thing, object and part, in the order of drawing."""
    nodes = {}
    for name, look in profile.things.items():
        nodes[f"#{name}"] = Node(f"#{name}", look.title or name, look)
    for name in subject.objects:
        look = profile.look(subject, name)
        if look.hidden:
            continue
        nodes[name] = Node(name, look.title or name, look)
        for part, of_part in look.parts:
            key = f"{name}#{part}"
            nodes[key] = Node(key, of_part.title or part, of_part)
            nodes[name].inside.append(nodes[key])
    return nodes


def _places(
    subject: Subject, profile: Profile, facts: Iterable[Atom], nodes: dict[str, Node]
) -> dict[str, tuple[str, str]]:
    """Return, for each node in or on another, the relation and the other node; cycles are excluded."""
    placed: dict[str, tuple[str, str]] = {}

    def put(what: str, how: str, where: str) -> None:
        at: str | None = where
        while at is not None and at != what:
            at = placed[at][1] if at in placed else at.split("#")[0] or None if at.find("#") > 0 else None
        if what in nodes and where in nodes and what not in placed and at is None:
            placed[what] = how, where

    for rule, fact in _said_by(profile.places, facts):
        what, where = rule.of(fact)
        put(what, rule.how, where)
    for name in subject.objects:
        inside = profile.look(subject, name).inside
        if inside is not None:
            put(name, "in", f"#{inside}")
    return placed


def _colour(profile: Profile, facts: Iterable[Atom], nodes: dict[str, Node]) -> None:
    pairs = sorted(rule.of(fact) for rule, fact in _said_by(profile.colours, facts))
    leaders = {leader for _, leader in pairs}
    number = {key: count for count, key in enumerate(key for key in nodes if key in leaders)}
    for what, leader in pairs:
        if what in nodes and leader in nodes:
            nodes[what].colour = nodes[leader].colour = number[leader]


def _want(profile: Profile, wanted: Wanted, done: bool, nodes: dict[str, Node]) -> None:
    """Add a part of the goal to the place that it is about, or to the object that has to change."""
    if wanted.atom is None:
        return
    rule = profile.places.get(wanted.atom[0]) or profile.marks.get(wanted.atom[0])
    if rule is None:
        return
    what, where = rule.of(wanted.atom)
    if what in nodes:
        nodes[what].done = done and nodes[what].done is not False  # a part of the goal places or marks it
    text = nodes[what].title if what in nodes else what
    if rule.how in ("in", "at") and where in nodes:
        nodes[where].wants.append((" ".join([*_unless(profile, wanted, "no"), text]), done))
    elif what in nodes:
        name = nodes[where].title if where in nodes else where
        nodes[what].wants.append((" ".join([*_unless(profile, wanted), *_how(profile, rule.how), name]), done))


def _connect(subject: Subject, profile: Profile, facts: Iterable[Atom], nodes: dict[str, Node]) -> None:
    """Add to each node its connections and their lengths."""
    for rule, fact in _said_by(profile.links, facts):
        what, where = Rule(rule.what, rule.how, rule.where).of(fact)
        if what in nodes and where in nodes:
            length = "" if rule.part is None else subject.numbers.get((rule.part, *fact[1:]), "")
            nodes[what].notes.append(f"{where} {length}".strip())


def _roots(
    subject: Subject, profile: Profile, nodes: dict[str, Node], placed: dict[str, tuple[str, str]]
) -> list[Node]:
    """Return the nodes that are in or on no other; small objects of one type share one heading."""
    roots: list[Node] = []
    headings: dict[str, Node] = {}
    for key, node in nodes.items():
        if key in placed or key.find("#") > 0:
            continue
        small = node.is_object and node.look.shape not in ("panel", "person", "robot")
        if small and not node.inside and not node.notes:
            kind = subject.objects[key]
            title = profile.texts("drawing.elsewhere", type=profile.names.get(kind, kind))
            heading = headings.setdefault(kind, Node(f"##{kind}", title, HEADING))
            heading.inside.append(node)
        else:
            roots.append(node)
    return [*roots, *headings.values()]


def _say(profile: Profile, placed: dict[str, tuple[str, str]], node: Node) -> str:
    words = []
    if node.key in placed:
        how, where = placed[node.key]
        words.append(" ".join([*_how(profile, how), profile.name(where)]))
    return f"{profile.name(node.key)} {', '.join([*words, *node.marks])}"
