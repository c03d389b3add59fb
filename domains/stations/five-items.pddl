; The largest rung: the boxes and benches of four-boxes.pddl with a second item
; in box-b; all but one item fit two kits, so that they can go wrong. 27 actions
; at best.
(define (problem five-items)
  (:domain stations)
  (:objects
    bench-1 bench-2 bench-3 - station
    box-a box-b box-c box-d - container
    hammer wrench chisel tape pliers - item)
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
    (contains box-b chisel) (belongs chisel box-b)
    (contains box-c tape) (belongs tape box-c)
    (contains box-d pliers) (belongs pliers box-d)
    (accepts bench-1 hammer) (accepts bench-1 wrench) (accepts bench-1 chisel)
    (accepts bench-2 hammer) (accepts bench-2 wrench) (accepts bench-2 tape)
    (accepts bench-3 tape) (accepts bench-3 pliers) (accepts bench-3 chisel))
  (:goal (and
    (in-kit hammer bench-1) (in-kit wrench bench-2) (in-kit chisel bench-1)
    (in-kit tape bench-3) (in-kit pliers bench-3)
    (stands-at box-a bench-1) (stands-at box-c bench-2))))
