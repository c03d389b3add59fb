; Four containers, six items, six slots that are all alike, as in the paper's
; task. 14 actions at best; 66,635 reachable states.
(define (problem ladder-4x6)
  (:domain kitting)
  (:objects
    box-a box-b box-c box-d - container
    hammer pliers wrench tape screwdriver file - item
    slot-1 slot-2 slot-3 slot-4 slot-5 slot-6 - slot)
  (:init
    (in-storage box-a) (in-storage box-b) (in-storage box-c) (in-storage box-d)
    (platform-free)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-a pliers) (belongs pliers box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (contains box-b tape) (belongs tape box-b)
    (contains box-c screwdriver) (belongs screwdriver box-c)
    (contains box-d file) (belongs file box-d)
    (slot-free slot-1) (slot-free slot-2) (slot-free slot-3) (slot-free slot-4)
    (slot-free slot-5) (slot-free slot-6)
    (removable slot-1) (removable slot-2) (removable slot-3) (removable slot-4)
    (removable slot-5) (removable slot-6)
    (fits hammer slot-1) (fits hammer slot-2) (fits hammer slot-3) (fits hammer slot-4)
    (fits hammer slot-5) (fits hammer slot-6)
    (fits pliers slot-1) (fits pliers slot-2) (fits pliers slot-3) (fits pliers slot-4)
    (fits pliers slot-5) (fits pliers slot-6)
    (fits wrench slot-1) (fits wrench slot-2) (fits wrench slot-3) (fits wrench slot-4)
    (fits wrench slot-5) (fits wrench slot-6)
    (fits tape slot-1) (fits tape slot-2) (fits tape slot-3) (fits tape slot-4)
    (fits tape slot-5) (fits tape slot-6)
    (fits screwdriver slot-1) (fits screwdriver slot-2) (fits screwdriver slot-3)
    (fits screwdriver slot-4) (fits screwdriver slot-5) (fits screwdriver slot-6)
    (fits file slot-1) (fits file slot-2) (fits file slot-3) (fits file slot-4)
    (fits file slot-5) (fits file slot-6))
  (:goal (and
    (in-slot hammer slot-1) (in-slot pliers slot-2) (in-slot wrench slot-3)
    (in-slot tape slot-4) (in-slot screwdriver slot-5) (in-slot file slot-6)
    (in-storage box-a) (in-storage box-b) (in-storage box-c) (in-storage box-d))))
