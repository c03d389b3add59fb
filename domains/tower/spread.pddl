; A tower is spread over all pegs, the lowest ball to the far one.
(define (problem spread)
  (:domain tower)
  (:objects
    red green blue - ball
    left-1 left-2 left-3 middle-1 middle-2 right-1 - place
    board air - level)
  (:init
    (at red left-1) (taken left-1) (at green left-2) (taken left-2) (at blue left-3) (taken left-3)
    (free middle-1) (free middle-2) (free right-1)
    (taken board) (free air)
    (above left-1 board) (above left-2 left-1) (above left-3 left-2) (above air left-3)
    (above middle-1 board) (above middle-2 middle-1) (above air middle-2)
    (above right-1 board) (above air right-1))
  (:goal (and (at blue left-1) (at green middle-1) (at red right-1))))
