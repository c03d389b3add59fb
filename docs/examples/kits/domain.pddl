; Kit fulfilment: one person fills a kit from containers that wait in storage.
;
; One container at a time stands on the unloading platform; only from and to
; that container can items be moved, one per action.  An item that sits in the
; wrong slot goes back the way it came, unless the slot is not removable.
(define (domain kitting)
  (:requirements :strips :typing)
  (:types container item slot)
  (:predicates
    (in-storage ?c - container)        ; the container stands at its place in storage
    (on-platform ?c - container)       ; the container stands on the unloading platform
    (platform-free)                    ; no container stands on the platform
    (contains ?c - container ?i - item) ; the item lies in its container
    (in-slot ?i - item ?s - slot)      ; the item lies in this slot of the kit
    (slot-free ?s - slot)              ; nothing lies in this slot
    (belongs ?i - item ?c - container) ; static: the container that the item comes from
    (fits ?i - item ?s - slot)         ; static: the slot can take the item
    (removable ?s - slot))             ; static: what lies in this slot can be taken out

  ; storage -> platform
  (:action fetch
    :parameters (?c - container)
    :precondition (and (in-storage ?c) (platform-free))
    :effect (and (on-platform ?c)
                 (not (in-storage ?c)) (not (platform-free))))

  ; platform -> storage
  (:action return
    :parameters (?c - container)
    :precondition (on-platform ?c)
    :effect (and (in-storage ?c) (platform-free)
                 (not (on-platform ?c))))

  ; container on the platform -> slot
  (:action place
    :parameters (?i - item ?s - slot ?c - container)
    :precondition (and (on-platform ?c) (contains ?c ?i)
                       (slot-free ?s) (fits ?i ?s))
    :effect (and (in-slot ?i ?s)
                 (not (contains ?c ?i)) (not (slot-free ?s))))

  ; slot -> container on the platform
  (:action remove
    :parameters (?i - item ?s - slot ?c - container)
    :precondition (and (on-platform ?c) (belongs ?i ?c)
                       (in-slot ?i ?s) (removable ?s))
    :effect (and (contains ?c ?i) (slot-free ?s)
                 (not (in-slot ?i ?s)))))
