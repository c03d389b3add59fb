; A kit of two items; its siblings in this folder differ in the goal only.
(define (problem mend)
  (:domain kitting)
  (:objects
    box-a box-b box-c - container
    hammer pliers wrench tape - item
    slot-1 slot-2 slot-3 slot-4 - slot)
  (:init
    (in-storage box-a) (in-storage box-b) (in-storage box-c)
    (platform-free)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-a pliers) (belongs pliers box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (contains box-c tape)   (belongs tape box-c)
    (slot-free slot-1) (slot-free slot-2) (slot-free slot-3) (slot-free slot-4)
    (removable slot-1) (removable slot-2) (removable slot-3) (removable slot-4)
    (fits hammer slot-1) (fits hammer slot-2) (fits hammer slot-3) (fits hammer slot-4)
    (fits pliers slot-1) (fits pliers slot-2) (fits pliers slot-3) (fits pliers slot-4)
    (fits wrench slot-1) (fits wrench slot-2) (fits wrench slot-3) (fits wrench slot-4)
    (fits tape slot-1)   (fits tape slot-2)   (fits tape slot-3)   (fits tape slot-4))
  (:goal (and
    (in-slot hammer slot-1) (in-slot wrench slot-2)
    (in-storage box-a) (in-storage box-b) (in-storage box-c))))
