"""Tree of a state: which object is in or on which other, marks for all other facts, and the goal.

Every fact that can change is shown: by the rule of its predicate, else as a mark on the first of its objects that is
drawn, else as a mark of the task. The same holds for the parts of the goal. Predicates that a profile hides are left
out.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from .profile import Look, Profile, Rule
from .subject import Atom, Subject, Wanted, is_number, words_for


@dataclass
class Node:
    """An object, a thing that is not an object, or a part of an object, with its contents.

    Attributes
    ----------
    key : str
        An object's name, `#thing`, `object#part`, `##heading`, or `TASK`.
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
        Facts that hold and are about no object that is drawn.
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
TASK = "##"
"""Key of the node with all that is about no object that is drawn."""


def arrange(subject: Subject, profile: Profile, values: Sequence[int], containers: Container[str] = ()) -> Scene:
    """Return the scene of a state.

    Parameters
    ----------
    subject : Subject
    profile : Profile
    values : sequence of int, shape (variables,)
        The state.
    containers : container of str
        The keys of all nodes in which others may be.
    """
    facts = subject.facts(values)
    nodes = _nodes(subject, profile)
    order = {name: number for number, name in enumerate(nodes)}
    placed, shown = _places(subject, profile, facts, nodes)
    for key in sorted(placed, key=order.__getitem__):
        how, where = placed[key]
        (nodes[where].on if how == "on" else nodes[where].inside).append(nodes[key])
    for rule, fact in _said_by(profile.marks, facts):
        key, word = rule.of(fact)
        if key in nodes:
            number = _value(subject, rule, fact, facts)
            nodes[key].marks.append(" ".join([word, profile.texts.texts["drawing.of"], number] if number else [word]))
            shown.add(fact)
    shown |= _colour(profile, facts, nodes) | _connect(subject, profile, facts, nodes)
    task = Node(TASK, profile.texts.texts["drawing.also"], HEADING)
    for fact in sorted(facts & subject.changing - shown):
        if fact[0] not in profile.hidden:
            owner = next((name for name in fact[1:] if name in nodes), None)
            (task if owner is None else nodes[owner]).marks.append(words_for(fact, owner))
    also = list(task.marks)
    goal = [(say_wanted(profile, wanted), subject.holds(wanted, facts, values)) for wanted in subject.goal]
    of_task: dict[str, bool] = {}
    for wanted, (text, done) in zip(subject.goal, goal, strict=True):
        if not _want(profile, wanted, done, nodes):
            of_task[text] = done and of_task.get(text, True)
    task.wants = list(of_task.items())
    for node in nodes.values():
        if node.done:
            node.done = all(so for wanted, (_, so) in zip(subject.goal, goal, strict=True) if wanted.names(node.key))
    said = [_say(profile, placed, nodes[key]) for key in nodes if key in placed or nodes[key].marks]
    if profile.guessed:
        said = sorted(words_for(fact) for fact in facts & subject.changing if words_for(fact) not in also)
    roots = _roots(subject, profile, nodes, placed, containers)
    return Scene([*roots, task] if task.marks or task.wants else roots, also, goal, said)


def say_wanted(profile: Profile, wanted: Wanted) -> str:
    """Return a part of the goal in words."""
    if wanted.atom is None:
        return wanted.text
    predicate = wanted.atom[0]
    rule = None if profile.guessed else profile.places.get(predicate) or profile.marks.get(predicate)
    if rule is None:
        return " ".join([*_unless(profile, wanted), words_for(wanted.atom)])
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
        for part, of_part in look.parts.items():
            key = f"{name}#{part}"
            nodes[key] = Node(key, of_part.title or part, of_part)
            nodes[name].inside.append(nodes[key])
    return nodes


def _places(
    subject: Subject, profile: Profile, facts: Iterable[Atom], nodes: dict[str, Node]
) -> tuple[dict[str, tuple[str, str]], set[Atom]]:
    """Return, for each node in or on another, the relation and the other node, and the facts that these show.

    Cycles are excluded, and an object is in one place.
    """
    placed: dict[str, tuple[str, str]] = {}
    shown = set[Atom]()

    def put(what: str, how: str, where: str) -> bool:
        at: str | None = where
        while at is not None and at != what:
            at = placed[at][1] if at in placed else at.split("#")[0] or None if at.find("#") > 0 else None
        if what not in nodes or where not in nodes or what in placed or at is not None:
            return False
        placed[what] = how, where
        return True

    for rule, fact in _said_by(profile.places, facts):
        what, where = rule.of(fact)
        if put(what, rule.how, where):
            shown.add(fact)
    for name in subject.objects:
        inside = profile.look(subject, name).inside
        if inside is not None:
            put(name, "in", f"#{inside}")
    return placed, shown


def _colour(profile: Profile, facts: Iterable[Atom], nodes: dict[str, Node]) -> set[Atom]:
    """Give nodes the colours of others, and return the facts that these show."""
    pairs = sorted((*rule.of(fact), fact) for rule, fact in _said_by(profile.colours, facts))
    leaders = {leader for _, leader, _ in pairs}
    number = {key: count for count, key in enumerate(key for key in nodes if key in leaders)}
    shown = set()
    for what, leader, fact in pairs:
        if what in nodes and leader in nodes:
            nodes[what].colour = nodes[leader].colour = number[leader]
            shown.add(fact)
    return shown


def _want(profile: Profile, wanted: Wanted, done: bool, nodes: dict[str, Node]) -> bool:
    """Add a part of the goal to the place that it is about, or to an object; return whether one is drawn."""
    if wanted.atom is None:
        return False
    rule = profile.places.get(wanted.atom[0]) or profile.marks.get(wanted.atom[0])
    what, where = ("", "") if rule is None else rule.of(wanted.atom)
    if what in nodes:
        nodes[what].done = done and nodes[what].done is not False  # a part of the goal places or marks it
    if rule is not None and rule.how in ("in", "at") and where in nodes:
        text = nodes[what].title if what in nodes else what
        nodes[where].wants.append((" ".join([*_unless(profile, wanted, "no"), text]), done))
        return True
    if rule is not None and what in nodes:
        name = nodes[where].title if where in nodes else where
        nodes[what].wants.append((" ".join([*_unless(profile, wanted), *_how(profile, rule.how), name]), done))
        return True
    owner = next((name for name in wanted.atom[1:] if name in nodes), None)
    if owner is not None:
        text = " ".join([*_unless(profile, wanted), words_for(wanted.atom, owner)])
        nodes[owner].wants.append((text, done))
        nodes[owner].done = done and nodes[owner].done is not False
    return owner is not None


def _connect(subject: Subject, profile: Profile, facts: Iterable[Atom], nodes: dict[str, Node]) -> set[Atom]:
    """Add to each node its connections and their lengths, and return the facts that these show."""
    shown = set()
    for rule, fact in _said_by(profile.links, facts):
        what, where = Rule(rule.what, rule.how, rule.where).of(fact)
        if what in nodes and where in nodes:
            nodes[what].notes.append(f"{where} {_value(subject, rule, fact, facts)}".strip())
            shown.add(fact)
    return shown


def _value(subject: Subject, rule: Rule, fact: Atom, facts: Iterable[Atom]) -> str:
    """Return the value in a state of the function that a rule names, of the arguments of a fact; empty for none."""
    if rule.part is None:
        return ""
    of = (rule.part, *(fact[1:-1] if is_number(fact) else fact[1:]))
    now = next((one[-1].removeprefix("= ") for one in facts if is_number(one) and one[:-1] == of), None)
    return subject.numbers.get(of, "") if now is None else now


def _roots(
    subject: Subject, profile: Profile, nodes: dict[str, Node], placed: dict[str, tuple[str, str]],
    containers: Container[str],
) -> list[Node]:  # fmt: skip
    """Return the nodes that are in or on no other; small objects of one type share one heading."""
    roots: list[Node] = []
    headings: dict[str, Node] = {}
    for key, node in nodes.items():
        if key in placed or key.find("#") > 0:
            continue
        small = node.is_object and node.look.shape not in ("panel", "person", "robot") and key not in containers
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
