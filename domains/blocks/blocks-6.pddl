; Two towers of three become one tower in which they alternate. 18 actions at
; best.
(define (problem blocks-6)
  (:domain blocks)
  (:objects
    a b c d e f - block)
  (:init
    (on-table a) (on b a) (on c b) (clear c)
    (on-table d) (on e d) (on f e) (clear f)
    (hand-empty))
  (:goal (and
    (on-table a) (on d a) (on b d) (on e b) (on c e) (on f c))))
