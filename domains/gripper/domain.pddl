; The robot with two grippers: it carries balls from one room to another, at most
; one ball in each gripper.
;
; The order of the balls and the choice of the gripper make no difference, so the
; number of states grows much faster than the number of really different ones.
(define (domain gripper)
  (:requirements :strips :typing)
  (:types room ball gripper)
  (:predicates
    (robot-in ?r - room)              ; where the robot is
    (lies-in ?b - ball ?r - room)     ; the ball lies on the floor of this room
    (empty ?g - gripper)              ; the gripper holds nothing
    (holds ?g - gripper ?b - ball))   ; the gripper holds this ball

  (:action go
    :parameters (?from ?to - room)
    :precondition (robot-in ?from)
    :effect (and (not (robot-in ?from)) (robot-in ?to)))

  ; floor -> gripper
  (:action grasp
    :parameters (?b - ball ?r - room ?g - gripper)
    :precondition (and (robot-in ?r) (lies-in ?b ?r) (empty ?g))
    :effect (and (holds ?g ?b)
                 (not (lies-in ?b ?r)) (not (empty ?g))))

  ; gripper -> floor
  (:action release
    :parameters (?b - ball ?r - room ?g - gripper)
    :precondition (and (robot-in ?r) (holds ?g ?b))
    :effect (and (lies-in ?b ?r) (empty ?g)
                 (not (holds ?g ?b)))))
