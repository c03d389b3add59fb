; The smallest that is still stations: one workbench, a stack of two boxes, the
; hammer in the upper one. 5 actions at best; there is nowhere to walk.
(define (problem one-bench)
  (:domain stations)
  (:objects
    bench-1 - station
    box-a box-b - container
    hammer - item)
  (:init
    (person-at bench-1)
    (stands-at box-a bench-1) (stack-begun bench-1) (lowest box-a)
    (stands-at box-b bench-1) (stacked box-b box-a) (covered box-a)
    (contains box-b hammer) (belongs hammer box-b)
    (accepts bench-1 hammer))
  (:goal (and
    (in-kit hammer bench-1) (stacked box-b box-a))))
