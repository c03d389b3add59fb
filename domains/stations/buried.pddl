; The box with the hammer stands under the other one, which has to go somewhere.
; Both kits take both items, so that either can go into the wrong kit. 14
; actions at best.
(define (problem buried)
  (:domain stations)
  (:objects
    bench-1 bench-2 - station
    box-a box-b - container
    hammer wrench - item)
  (:init
    (person-at bench-1)
    (path bench-1 bench-2) (path bench-2 bench-1)
    (stands-at box-a bench-1) (stack-begun bench-1) (lowest box-a)
    (stands-at box-b bench-1) (stacked box-b box-a) (covered box-a)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (accepts bench-1 hammer) (accepts bench-1 wrench)
    (accepts bench-2 hammer) (accepts bench-2 wrench))
  (:goal (and
    (in-kit hammer bench-1) (in-kit wrench bench-2)
    (stands-at box-a bench-1) (stands-at box-b bench-1))))
