; Kits from bins that are counted. A bin has a number of parts of one kind, an order
; says how many of each kind a tray needs, and a tray has room for more than that. A
; bin that runs low is refilled with a whole pack, which costs more and needs room.
(define (domain stock)
  (:requirements :typing :negative-preconditions :universal-preconditions :numeric-fluents :action-costs)
  (:types kind bin tray)
  (:predicates
    (holds ?b - bin ?k - kind)            ; static: what the bin is for
    (sent ?t - tray))                     ; the tray has left with what it holds
  (:functions
    (total-cost)
    (parts ?b - bin)                      ; parts in the bin
    (size ?b - bin)                       ; static: parts for which the bin has room
    (packs ?b - bin)                      ; packs left to refill the bin with
    (pack ?b - bin)                       ; static: parts of a pack
    (placed ?k - kind ?t - tray)          ; parts of a kind on the tray
    (ordered ?k - kind ?t - tray)         ; static: parts that the order needs
    (room ?k - kind ?t - tray))           ; static: parts of a kind for which the tray has room

  (:action pick
    :parameters (?k - kind ?b - bin ?t - tray)
    :precondition (and (holds ?b ?k) (not (sent ?t)) (>= (parts ?b) 1) (< (placed ?k ?t) (room ?k ?t)))
    :effect (and (decrease (parts ?b) 1) (increase (placed ?k ?t) 1) (increase (total-cost) 1)))

  (:action put-back
    :parameters (?k - kind ?b - bin ?t - tray)
    :precondition (and (holds ?b ?k) (not (sent ?t)) (>= (placed ?k ?t) 1) (< (parts ?b) (size ?b)))
    :effect (and (increase (parts ?b) 1) (decrease (placed ?k ?t) 1) (increase (total-cost) 1)))

  (:action refill
    :parameters (?b - bin)
    :precondition (and (>= (packs ?b) 1) (<= (+ (parts ?b) (pack ?b)) (size ?b)))
    :effect (and (increase (parts ?b) (pack ?b)) (decrease (packs ?b) 1) (increase (total-cost) 3)))

  (:action send
    :parameters (?t - tray)
    :precondition (and (not (sent ?t)) (forall (?k - kind) (= (placed ?k ?t) (ordered ?k ?t))))
    :effect (and (sent ?t) (increase (total-cost) 1))))
