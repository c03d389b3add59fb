; Three balls: two go together, one alone. 9 actions at best.
(define (problem balls-03)
  (:domain gripper)
  (:objects
    room-a room-b - room
    ball-1 ball-2 ball-3 - ball
    left right - gripper)
  (:init
    (robot-in room-a) (empty left) (empty right)
    (lies-in ball-1 room-a) (lies-in ball-2 room-a) (lies-in ball-3 room-a))
  (:goal (and
    (lies-in ball-1 room-b) (lies-in ball-2 room-b) (lies-in ball-3 room-b))))
