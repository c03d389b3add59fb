; Two towers trade their lowest blocks. 10 actions at best.
(define (problem blocks-5)
  (:domain blocks)
  (:objects
    a b c d e - block)
  (:init
    (on-table a) (on b a) (on c b) (clear c)
    (on-table d) (on e d) (clear e)
    (hand-empty))
  (:goal (and
    (on-table d) (on b d) (on c b)
    (on-table a) (on e a))))
