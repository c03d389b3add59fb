; The largest rung: two towers of four exchange their lower halves. 22 actions
; at best.
(define (problem blocks-8)
  (:domain blocks)
  (:objects
    a b c d e f g h - block)
  (:init
    (on-table a) (on b a) (on c b) (on d c) (clear d)
    (on-table e) (on f e) (on g f) (on h g) (clear h)
    (hand-empty))
  (:goal (and
    (on-table f) (on e f) (on c e) (on d c)
    (on-table b) (on a b) (on g a) (on h g))))
