; Four boxes in two stacks, three workbenches that one can go round, four items.
; 24 actions at best.
(define (problem four-boxes)
  (:domain stations)
  (:objects
    bench-1 bench-2 bench-3 - station
    box-a box-b box-c box-d - container
    hammer wrench tape pliers - item)
  (:init
    (person-at bench-1)
    (path bench-1 bench-2) (path bench-2 bench-1) (path bench-2 bench-3) (path bench-3 bench-2)
    (path bench-3 bench-1) (path bench-1 bench-3)
    (stands-at box-a bench-1) (stack-begun bench-1) (lowest box-a)
    (stands-at box-b bench-1) (stacked box-b box-a) (covered box-a)
    (stands-at box-c bench-2) (stack-begun bench-2) (lowest box-c)
    (stands-at box-d bench-2) (stacked box-d box-c) (covered box-c)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (contains box-c tape) (belongs tape box-c)
    (contains box-d pliers) (belongs pliers box-d)
    (accepts bench-1 hammer)
    (accepts bench-2 wrench)
    (accepts bench-3 tape) (accepts bench-3 pliers))
  (:goal (and
    (in-kit hammer bench-1) (in-kit wrench bench-2) (in-kit tape bench-3)
    (in-kit pliers bench-3)
    (stands-at box-a bench-1) (stands-at box-c bench-2))))
