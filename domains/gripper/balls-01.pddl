; One ball: grasp it, go, release it. 3 actions at best.
(define (problem balls-01)
  (:domain gripper)
  (:objects
    room-a room-b - room
    ball-1 - ball
    left right - gripper)
  (:init
    (robot-in room-a) (empty left) (empty right)
    (lies-in ball-1 room-a))
  (:goal (and
    (lies-in ball-1 room-b))))
