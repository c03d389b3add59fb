; Two workbenches and one box: the wrench is needed at the other bench, and the
; box has to be brought back. 10 actions at best.
(define (problem two-benches)
  (:domain stations)
  (:objects
    bench-1 bench-2 - station
    box-a - container
    hammer wrench - item)
  (:init
    (person-at bench-1)
    (path bench-1 bench-2) (path bench-2 bench-1)
    (stands-at box-a bench-1) (stack-begun bench-1) (lowest box-a)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-a wrench) (belongs wrench box-a)
    (accepts bench-1 hammer)
    (accepts bench-2 hammer) (accepts bench-2 wrench))
  (:goal (and
    (in-kit hammer bench-1) (in-kit wrench bench-2)
    (stands-at box-a bench-1))))
