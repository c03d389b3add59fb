; The smallest rung: whichever of the two goals is reached first has to be
; undone for the other. 6 actions at best.
(define (problem blocks-3)
  (:domain blocks)
  (:objects
    a b c - block)
  (:init
    (on-table a) (on c a) (clear c)
    (on-table b) (clear b)
    (hand-empty))
  (:goal (and
    (on-table c) (on b c) (on a b))))
