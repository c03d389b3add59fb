; Three containers, four items that each have a slot of their own, and a spare
; part that has one as well but that the target arrangement leaves in its
; container.  Ten actions at best.
(define (problem paper-fixed)
  (:domain kitting)
  (:objects
    box-a box-b box-c - container
    hammer pliers wrench tape spare - item
    slot-1 slot-2 slot-3 slot-4 slot-5 - slot)
  (:init
    (in-storage box-a) (in-storage box-b) (in-storage box-c)
    (platform-free)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-a pliers) (belongs pliers box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (contains box-b spare)  (belongs spare box-b)
    (contains box-c tape)   (belongs tape box-c)
    (slot-free slot-1) (slot-free slot-2) (slot-free slot-3) (slot-free slot-4) (slot-free slot-5)
    (removable slot-1) (removable slot-2) (removable slot-3) (removable slot-4) (removable slot-5)
    (fits hammer slot-1) (fits pliers slot-2) (fits wrench slot-3) (fits tape slot-4) (fits spare slot-5))
  (:goal (and
    (in-slot hammer slot-1) (in-slot pliers slot-2)
    (in-slot wrench slot-3) (in-slot tape slot-4) (slot-free slot-5)
    (in-storage box-a) (in-storage box-b) (in-storage box-c))))
