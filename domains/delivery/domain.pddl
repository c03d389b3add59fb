; Delivery rounds: vans take parcels to their addresses.  Driving costs what the
; road is long; loading and unloading cost nothing, so whole runs of actions are
; free and a state can have many cheapest ways to the goal.
;
; A light parcel is loaded by the driver alone.  For a heavy one the driver of
; another van has to be at the same place to lend a hand: that precondition is a
; disjunction with an existential quantifier and an inequality in it, all of which
; grounding compiles away.
(define (domain delivery)
  (:requirements :strips :typing :equality :negative-preconditions
                 :disjunctive-preconditions :existential-preconditions :action-costs)
  (:types place van parcel)
  (:predicates
    (road ?from ?to - place)          ; static: there is a road this way
    (light ?p - parcel)               ; static: one person can lift the parcel
    (van-at ?v - van ?x - place)      ; where the van is
    (lies-at ?p - parcel ?x - place)  ; the parcel lies at this place
    (in-van ?p - parcel ?v - van))    ; the parcel is in the van
  (:functions
    (total-cost) - number
    (length ?from ?to - place) - number) ; static: how long the road is

  (:action drive
    :parameters (?v - van ?from ?to - place)
    :precondition (and (van-at ?v ?from) (road ?from ?to))
    :effect (and (van-at ?v ?to) (not (van-at ?v ?from))
                 (increase (total-cost) (length ?from ?to))))

  ; place -> van, free of cost
  (:action load
    :parameters (?p - parcel ?v - van ?x - place)
    :precondition (and (van-at ?v ?x) (lies-at ?p ?x)
                       (or (light ?p)
                           (exists (?helper - van)
                             (and (not (= ?helper ?v)) (van-at ?helper ?x)))))
    :effect (and (in-van ?p ?v) (not (lies-at ?p ?x))))

  ; van -> place, free of cost; a heavy parcel slides down by itself
  (:action unload
    :parameters (?p - parcel ?v - van ?x - place)
    :precondition (and (van-at ?v ?x) (in-van ?p ?v))
    :effect (and (lies-at ?p ?x) (not (in-van ?p ?v)))))
