; Ten balls from one room to the other. 29 actions at best.
(define (problem balls-10)
  (:domain gripper)
  (:objects
    room-a room-b - room
    ball-1 ball-2 ball-3 ball-4 ball-5 ball-6 ball-7 ball-8 ball-9 ball-10 - ball
    left right - gripper)
  (:init
    (robot-in room-a) (empty left) (empty right)
    (lies-in ball-1 room-a) (lies-in ball-2 room-a) (lies-in ball-3 room-a)
    (lies-in ball-4 room-a) (lies-in ball-5 room-a) (lies-in ball-6 room-a)
    (lies-in ball-7 room-a) (lies-in ball-8 room-a) (lies-in ball-9 room-a)
    (lies-in ball-10 room-a))
  (:goal (and
    (lies-in ball-1 room-b) (lies-in ball-2 room-b) (lies-in ball-3 room-b)
    (lies-in ball-4 room-b) (lies-in ball-5 room-b) (lies-in ball-6 room-b)
    (lies-in ball-7 room-b) (lies-in ball-8 room-b) (lies-in ball-9 room-b)
    (lies-in ball-10 room-b))))
