; Tower of London: balls on three pegs, of which one holds three, one two, and
; one a single ball.  One ball at a time is moved, from the top of a peg to the
; top of another.
;
; A peg is a column of places, each above another.  Lowest of all is the board,
; which is always taken, highest of all is the air, which is always free.
(define (domain tower)
  (:requirements :strips :typing :negative-preconditions :existential-preconditions)
  (:types
    ball level - object
    place - level)  ; a level that can hold a ball
  (:predicates
    (at ?b - ball ?p - place)
    (free ?p - level)
    (taken ?p - level)
    (above ?p ?q - level))  ; static: directly above

  (:action move
    :parameters (?b - ball ?from ?to - place)
    :precondition (and (at ?b ?from) (free ?to) (not (above ?to ?from))
                       (exists (?next - level) (and (above ?next ?from) (free ?next)))
                       (exists (?below - level) (and (above ?to ?below) (taken ?below))))
    :effect (and (at ?b ?to) (taken ?to) (free ?from)
                 (not (at ?b ?from)) (not (free ?to)) (not (taken ?from)))))
