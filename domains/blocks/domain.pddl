; Blocksworld with a hand: towers of blocks stand on a table that is large enough
; for all of them, and a hand moves one block at a time, always from the top of a
; tower or from the table.
(define (domain blocks)
  (:requirements :strips :typing)
  (:types block)
  (:predicates
    (on ?b ?below - block)    ; the block stands on the other one
    (on-table ?b - block)     ; the block stands on the table
    (clear ?b - block)        ; nothing stands on the block, and the hand does not hold it
    (holding ?b - block)      ; the hand holds the block
    (hand-empty))             ; the hand holds nothing

  ; table -> hand
  (:action pick-up
    :parameters (?b - block)
    :precondition (and (on-table ?b) (clear ?b) (hand-empty))
    :effect (and (holding ?b)
                 (not (on-table ?b)) (not (clear ?b)) (not (hand-empty))))

  ; hand -> table
  (:action put-down
    :parameters (?b - block)
    :precondition (holding ?b)
    :effect (and (on-table ?b) (clear ?b) (hand-empty)
                 (not (holding ?b))))

  ; top of a tower -> hand
  (:action unstack
    :parameters (?b ?below - block)
    :precondition (and (on ?b ?below) (clear ?b) (hand-empty))
    :effect (and (holding ?b) (clear ?below)
                 (not (on ?b ?below)) (not (clear ?b)) (not (hand-empty))))

  ; hand -> top of a tower
  (:action stack
    :parameters (?b ?below - block)
    :precondition (and (holding ?b) (clear ?below))
    :effect (and (on ?b ?below) (clear ?b) (hand-empty)
                 (not (holding ?b)) (not (clear ?below)))))
