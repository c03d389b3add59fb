; Five containers, five items, five slots that are all alike, as in the paper's
; task. 15 actions at best; 9,276 reachable states.
(define (problem ladder-5x5)
  (:domain kitting)
  (:objects
    box-a box-b box-c box-d box-e - container
    hammer pliers wrench tape screwdriver - item
    slot-1 slot-2 slot-3 slot-4 slot-5 - slot)
  (:init
    (in-storage box-a) (in-storage box-b) (in-storage box-c) (in-storage box-d)
    (in-storage box-e)
    (platform-free)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-b pliers) (belongs pliers box-b)
    (contains box-c wrench) (belongs wrench box-c)
    (contains box-d tape) (belongs tape box-d)
    (contains box-e screwdriver) (belongs screwdriver box-e)
    (slot-free slot-1) (slot-free slot-2) (slot-free slot-3) (slot-free slot-4)
    (slot-free slot-5)
    (removable slot-1) (removable slot-2) (removable slot-3) (removable slot-4)
    (removable slot-5)
    (fits hammer slot-1) (fits hammer slot-2) (fits hammer slot-3) (fits hammer slot-4)
    (fits hammer slot-5)
    (fits pliers slot-1) (fits pliers slot-2) (fits pliers slot-3) (fits pliers slot-4)
    (fits pliers slot-5)
    (fits wrench slot-1) (fits wrench slot-2) (fits wrench slot-3) (fits wrench slot-4)
    (fits wrench slot-5)
    (fits tape slot-1) (fits tape slot-2) (fits tape slot-3) (fits tape slot-4)
    (fits tape slot-5)
    (fits screwdriver slot-1) (fits screwdriver slot-2) (fits screwdriver slot-3)
    (fits screwdriver slot-4) (fits screwdriver slot-5))
  (:goal (and
    (in-slot hammer slot-1) (in-slot pliers slot-2) (in-slot wrench slot-3)
    (in-slot tape slot-4) (in-slot screwdriver slot-5)
    (in-storage box-a) (in-storage box-b) (in-storage box-c) (in-storage box-d)
    (in-storage box-e))))
