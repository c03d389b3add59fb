
; Boards are set in and screwed on. Moving a board takes both hands.
(define (domain shelf)
  (:requirements :strips :typing :negative-preconditions)
  (:types board height)
  (:predicates
    (fits ?b - board ?h - height)
    (free ?h - height)
    (on-floor ?b - board)
    (set-at ?b - board ?h - height)
    (screwed ?b - board)
    (driver-in-hand))

  (:action take-driver
    :parameters ()
    :precondition (not (driver-in-hand))
    :effect (driver-in-hand))

  (:action put-driver-down
    :parameters ()
    :precondition (driver-in-hand)
    :effect (not (driver-in-hand)))

  (:action set-in
    :parameters (?b - board ?h - height)
    :precondition (and (on-floor ?b) (free ?h) (fits ?b ?h) (not (driver-in-hand)))
    :effect (and (set-at ?b ?h) (not (on-floor ?b)) (not (free ?h))))

  (:action lift-out
    :parameters (?b - board ?h - height)
    :precondition (and (set-at ?b ?h) (not (screwed ?b)) (not (driver-in-hand)))
    :effect (and (on-floor ?b) (free ?h) (not (set-at ?b ?h))))

  (:action screw
    :parameters (?b - board ?h - height)
    :precondition (and (set-at ?b ?h) (not (screwed ?b)) (driver-in-hand))
    :effect (screwed ?b))

  (:action unscrew
    :parameters (?b - board ?h - height)
    :precondition (and (set-at ?b ?h) (screwed ?b) (driver-in-hand))
    :effect (not (screwed ?b))))
