; Two workbenches with a door between them that opens in one direction only:
; whoever goes to bench-2 before the kit of bench-1 is right, or without the box
; that is needed there, cannot go back. Dead ends. 7 actions at best.
(define (problem one-way)
  (:domain stations)
  (:objects
    bench-1 bench-2 - station
    box-a box-b - container
    hammer wrench - item)
  (:init
    (person-at bench-1)
    (path bench-1 bench-2)
    (stands-at box-b bench-1) (stack-begun bench-1) (lowest box-b)
    (stands-at box-a bench-1) (stacked box-a box-b) (covered box-b)
    (contains box-a hammer) (belongs hammer box-a)
    (contains box-b wrench) (belongs wrench box-b)
    (accepts bench-1 hammer) (accepts bench-1 wrench)
    (accepts bench-2 hammer) (accepts bench-2 wrench))
  (:goal (and
    (in-kit hammer bench-1) (in-kit wrench bench-2))))
