; Parcel lockers: parcels ride on trays from where they arrive to the lockers that
; their buyers will open.
;
; Pushing a tray moves every parcel that lies on it, tipping it empties it into a
; locker, and shutting a locker seals whatever is in it: one action, many effects.
; A locker that has no key stays shut, so shutting it too early, or on the wrong
; parcel, is a dead end.
(define (domain lockers)
  (:requirements :strips :typing :negative-preconditions :conditional-effects)
  (:types place locker tray parcel)
  (:predicates
    (next-to ?x ?y - place)            ; static: trays can be pushed from ?x to ?y
    (stands-at ?l - locker ?x - place) ; static: the locker is reached from this place
    (has-key ?l - locker)              ; static: the locker can be unlocked once it is shut
    (tray-at ?t - tray ?x - place)     ; where the tray is
    (parcel-at ?p - parcel ?x - place) ; where the parcel is, on a tray or not; of none that is in a locker
    (on-tray ?p - parcel ?t - tray)    ; the parcel lies on the tray
    (loose ?p - parcel)                ; the parcel lies on no tray and in no locker
    (inside ?p - parcel ?l - locker)   ; the parcel is in the locker
    (shut ?l - locker)                 ; the locker is shut
    (sealed ?p - parcel))              ; the parcel is in a locker that is shut

  ; floor -> tray
  (:action load
    :parameters (?p - parcel ?t - tray ?x - place)
    :precondition (and (loose ?p) (parcel-at ?p ?x) (tray-at ?t ?x))
    :effect (and (on-tray ?p ?t) (not (loose ?p))))

  ; tray -> floor
  (:action unload
    :parameters (?p - parcel ?t - tray)
    :precondition (on-tray ?p ?t)
    :effect (and (loose ?p) (not (on-tray ?p ?t))))

  ; what lies on the tray goes with it
  (:action push
    :parameters (?t - tray ?from ?to - place)
    :precondition (and (tray-at ?t ?from) (next-to ?from ?to))
    :effect (and (tray-at ?t ?to) (not (tray-at ?t ?from))
                 (forall (?p - parcel)
                   (when (on-tray ?p ?t)
                         (and (parcel-at ?p ?to) (not (parcel-at ?p ?from)))))))

  ; all that lies on the tray -> locker
  (:action tip
    :parameters (?t - tray ?l - locker ?x - place)
    :precondition (and (tray-at ?t ?x) (stands-at ?l ?x) (not (shut ?l)))
    :effect (forall (?p - parcel)
              (when (on-tray ?p ?t)
                    (and (inside ?p ?l)
                         (not (on-tray ?p ?t)) (not (parcel-at ?p ?x))))))

  ; locker -> floor
  (:action take-out
    :parameters (?p - parcel ?l - locker ?x - place)
    :precondition (and (inside ?p ?l) (stands-at ?l ?x) (not (shut ?l)))
    :effect (and (parcel-at ?p ?x) (loose ?p) (not (inside ?p ?l))))

  ; seals all that is inside, or nothing
  (:action shut-door
    :parameters (?l - locker)
    :precondition (not (shut ?l))
    :effect (and (shut ?l)
                 (forall (?p - parcel)
                   (when (inside ?p ?l) (sealed ?p)))))

  ; unseals all that is inside
  (:action unlock
    :parameters (?l - locker)
    :precondition (and (shut ?l) (has-key ?l))
    :effect (and (not (shut ?l))
                 (forall (?p - parcel)
                   (when (inside ?p ?l) (not (sealed ?p)))))))
