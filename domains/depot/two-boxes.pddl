(define (problem two-boxes)
  (:domain depot)
  (:objects
    bench pallet-1 pallet-2
    box-a box-b
    kind-a kind-b
    column-1
    n0 n1 n2)
  (:init
    (hoist-free)
    (working bench)
    (on box-b pallet-2)
    (on box-a box-b)
    (clear bench)
    (clear pallet-1)
    (clear box-a)
    (next n0 n1)
    (next n1 n2)
    (holds box-a kind-a)
    (holds box-b kind-b)
    (room column-1 n1)
    (room column-1 n2)
    (height column-1 n0)
    (stock kind-a n1)
    (tray kind-a n0)
    (stock kind-b n1)
    (tray kind-b n0))
  (:goal (and
    (cell column-1 n1 kind-a)
    (on box-b box-a)
    (on box-a pallet-2))))
