; Three boxes in one stack, two workbenches that each need two items out of
; different boxes. 28 actions at best.
(define (problem three-boxes)
  (:domain stations)
  (:objects
    bench-1 bench-2 - station
    box-a box-b box-c - container
    hammer wrench tape pliers - item)
  (:init
    (person-at bench-1)
    (path bench-1 bench-2) (path bench-2 bench-1)
    (stands-at box-a bench-1) (stack-begun bench-1) (lowest box-a)
    (stands-at box-b bench-1) (stacked box-b box-a) (covered box-a)
    (stands-at box-c bench-1) (stacked box-c box-b) (covered box-b)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (contains box-b tape) (belongs tape box-b)
    (contains box-c pliers) (belongs pliers box-c)
    (accepts bench-1 hammer) (accepts bench-1 wrench)
    (accepts bench-2 tape) (accepts bench-2 pliers))
  (:goal (and
    (in-kit hammer bench-1) (in-kit wrench bench-1)
    (in-kit tape bench-2) (in-kit pliers bench-2)
    (stands-at box-a bench-1) (stands-at box-b bench-1) (stands-at box-c bench-1))))
