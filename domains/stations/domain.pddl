; Kitting at several stations: one person walks between workbenches, carries one
; container at a time and fills the kit of each station.
;
; At each station there is one stack of containers and one platform.  Only the
; uppermost container of a stack can be lifted, and only from the container on
; the platform of the same station can items be moved, with both hands empty.
; An item that went into the wrong kit goes back the way it came.
(define (domain stations)
  (:requirements :strips :typing :negative-preconditions)
  (:types station container item)
  (:predicates
    (path ?from ?to - station)               ; static: one can walk this way
    (person-at ?s - station)                 ; where the person stands
    (hands-full)                             ; the person carries a container
    (carrying ?c - container)                ; the person carries this container
    (stands-at ?c - container ?s - station)  ; the container is in the stack of this station
    (lowest ?c - container)                  ; the container is at the foot of its stack
    (stacked ?c ?below - container)          ; the container stands on the other one
    (covered ?c - container)                 ; another container stands on it
    (stack-begun ?s - station)               ; the stack of the station is not empty
    (on-platform ?c - container ?s - station) ; the container stands on the station's platform
    (platform-taken ?s - station)            ; some container stands on the platform
    (contains ?c - container ?i - item)      ; the item lies in its container
    (in-kit ?i - item ?s - station)          ; the item lies in the kit of this station
    (belongs ?i - item ?c - container)       ; static: the container that the item comes from
    (accepts ?s - station ?i - item))        ; static: the kit of the station has a place for the item

  ; with or without a container in the hands
  (:action walk
    :parameters (?from ?to - station)
    :precondition (and (person-at ?from) (path ?from ?to))
    :effect (and (person-at ?to) (not (person-at ?from))))

  ; the last container of a stack -> hands
  (:action lift-last
    :parameters (?c - container ?s - station)
    :precondition (and (person-at ?s) (not (hands-full))
                       (stands-at ?c ?s) (lowest ?c) (not (covered ?c)))
    :effect (and (carrying ?c) (hands-full)
                 (not (stands-at ?c ?s)) (not (lowest ?c)) (not (stack-begun ?s))))

  ; top of a stack -> hands
  (:action lift
    :parameters (?c ?below - container ?s - station)
    :precondition (and (person-at ?s) (not (hands-full))
                       (stands-at ?c ?s) (stacked ?c ?below) (not (covered ?c)))
    :effect (and (carrying ?c) (hands-full)
                 (not (stands-at ?c ?s)) (not (stacked ?c ?below)) (not (covered ?below))))

  ; hands -> foot of a new stack
  (:action set-first
    :parameters (?c - container ?s - station)
    :precondition (and (person-at ?s) (carrying ?c) (not (stack-begun ?s)))
    :effect (and (stands-at ?c ?s) (lowest ?c) (stack-begun ?s)
                 (not (carrying ?c)) (not (hands-full))))

  ; hands -> top of a stack
  (:action set-down
    :parameters (?c ?below - container ?s - station)
    :precondition (and (person-at ?s) (carrying ?c)
                       (stands-at ?below ?s) (not (covered ?below)))
    :effect (and (stands-at ?c ?s) (stacked ?c ?below) (covered ?below)
                 (not (carrying ?c)) (not (hands-full))))

  ; hands -> platform
  (:action mount
    :parameters (?c - container ?s - station)
    :precondition (and (person-at ?s) (carrying ?c) (not (platform-taken ?s)))
    :effect (and (on-platform ?c ?s) (platform-taken ?s)
                 (not (carrying ?c)) (not (hands-full))))

  ; platform -> hands
  (:action unmount
    :parameters (?c - container ?s - station)
    :precondition (and (person-at ?s) (on-platform ?c ?s) (not (hands-full)))
    :effect (and (carrying ?c) (hands-full)
                 (not (on-platform ?c ?s)) (not (platform-taken ?s))))

  ; container on the platform -> kit of the station
  (:action fill
    :parameters (?i - item ?c - container ?s - station)
    :precondition (and (person-at ?s) (not (hands-full))
                       (on-platform ?c ?s) (contains ?c ?i) (accepts ?s ?i))
    :effect (and (in-kit ?i ?s) (not (contains ?c ?i))))

  ; kit of the station -> container on the platform
  (:action put-back
    :parameters (?i - item ?c - container ?s - station)
    :precondition (and (person-at ?s) (not (hands-full))
                       (on-platform ?c ?s) (belongs ?i ?c) (in-kit ?i ?s))
    :effect (and (contains ?c ?i) (not (in-kit ?i ?s)))))
