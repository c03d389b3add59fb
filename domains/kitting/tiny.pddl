; Two containers with one item each, two slots that take both: small enough to
; be worked out by hand.  Six actions at best.
(define (problem tiny)
  (:domain kitting)
  (:objects
    box-a box-b - container
    hammer wrench - item
    slot-1 slot-2 - slot)
  (:init
    (in-storage box-a) (in-storage box-b)
    (platform-free)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (slot-free slot-1) (slot-free slot-2)
    (removable slot-1) (removable slot-2)
    (fits hammer slot-1) (fits hammer slot-2)
    (fits wrench slot-1) (fits wrench slot-2))
  (:goal (and
    (in-slot hammer slot-1) (in-slot wrench slot-2)
    (in-storage box-a) (in-storage box-b))))
