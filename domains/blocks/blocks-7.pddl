; One tower is split into two: the blocks at odd and those at even places. 22
; actions at best.
(define (problem blocks-7)
  (:domain blocks)
  (:objects
    a b c d e f g - block)
  (:init
    (on-table a) (on b a) (on c b) (on d c) (on e d) (on f e) (on g f) (clear g)
    (hand-empty))
  (:goal (and
    (on-table a) (on c a) (on e c) (on g e)
    (on-table b) (on d b) (on f d))))
