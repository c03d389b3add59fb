; Three workbenches in a row, three boxes, four items; the benches at the two
; ends both take the hammer and the wrench. 25 actions at best.
(define (problem three-benches)
  (:domain stations)
  (:objects
    bench-1 bench-2 bench-3 - station
    box-a box-b box-c - container
    hammer wrench tape pliers - item)
  (:init
    (person-at bench-2)
    (path bench-1 bench-2) (path bench-2 bench-1) (path bench-2 bench-3) (path bench-3 bench-2)
    (stands-at box-a bench-1) (stack-begun bench-1) (lowest box-a)
    (stands-at box-b bench-1) (stacked box-b box-a) (covered box-a)
    (stands-at box-c bench-2) (stack-begun bench-2) (lowest box-c)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (contains box-b tape) (belongs tape box-b)
    (contains box-c pliers) (belongs pliers box-c)
    (accepts bench-1 hammer) (accepts bench-1 wrench)
    (accepts bench-2 tape) (accepts bench-2 pliers)
    (accepts bench-3 hammer) (accepts bench-3 wrench))
  (:goal (and
    (in-kit hammer bench-1) (in-kit tape bench-2) (in-kit pliers bench-2)
    (in-kit wrench bench-3)
    (stands-at box-a bench-1) (stands-at box-b bench-1) (stands-at box-c bench-2))))
