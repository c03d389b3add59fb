; Two containers, three items, three slots that are all alike, as in the paper's
; task. 7 actions at best; 102 reachable states.
(define (problem ladder-2x3)
  (:domain kitting)
  (:objects
    box-a box-b - container
    hammer pliers wrench - item
    slot-1 slot-2 slot-3 - slot)
  (:init
    (in-storage box-a) (in-storage box-b)
    (platform-free)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-a pliers) (belongs pliers box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (slot-free slot-1) (slot-free slot-2) (slot-free slot-3)
    (removable slot-1) (removable slot-2) (removable slot-3)
    (fits hammer slot-1) (fits hammer slot-2) (fits hammer slot-3)
    (fits pliers slot-1) (fits pliers slot-2) (fits pliers slot-3)
    (fits wrench slot-1) (fits wrench slot-2) (fits wrench slot-3))
  (:goal (and
    (in-slot hammer slot-1) (in-slot pliers slot-2) (in-slot wrench slot-3)
    (in-storage box-a) (in-storage box-b))))
