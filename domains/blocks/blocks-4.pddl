; A tower of four is turned upside down. 8 actions at best.
(define (problem blocks-4)
  (:domain blocks)
  (:objects
    a b c d - block)
  (:init
    (on-table d) (on c d) (on b c) (on a b) (clear a)
    (hand-empty))
  (:goal (and
    (on-table a) (on b a) (on c b) (on d c))))
