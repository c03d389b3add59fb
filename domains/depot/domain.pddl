; Kitting from stacked boxes into a display, with counted items.
;
; Written as planners' domains often are: untyped STRIPS, items of a kind are not
; told apart but counted, a column of the display is a stack of cells with a
; height, and boxes stand on each other on pallets.  One of the pallets is the
; bench: of the box that stands open there, items go onto the tray and back.
(define (domain depot)
  (:requirements :strips)
  (:predicates
    (next ?m ?n)       ; static: the number after ?m is ?n
    (working ?s)      ; static: a box that stands here can be emptied
    (holds ?b ?k)      ; static: the kind of item that is in this box
    (room ?c ?n)       ; static: the column has so many cells, or more
    (on ?b ?s)         ; the box stands on a pallet or on another box
    (clear ?s)         ; nothing stands on it
    (lifting ?b)       ; the hoist holds the box
    (hoist-free)
    (stock ?k ?n)      ; so many items of this kind are in their box
    (tray ?k ?n)       ; so many are on the tray
    (height ?c ?n)     ; so many cells of the column are filled
    (cell ?c ?n ?k))   ; the n-th cell of the column holds an item of this kind

  (:action lift
    :parameters (?b ?s)
    :precondition (and (hoist-free) (on ?b ?s) (clear ?b))
    :effect (and (lifting ?b) (clear ?s)
                 (not (hoist-free)) (not (on ?b ?s)) (not (clear ?b))))

  (:action put
    :parameters (?b ?s)
    :precondition (and (lifting ?b) (clear ?s))
    :effect (and (hoist-free) (on ?b ?s) (clear ?b)
                 (not (lifting ?b)) (not (clear ?s))))

  ; box on the bench -> tray
  (:action take
    :parameters (?k ?b ?s ?less ?more ?few ?many)
    :precondition (and (working ?s) (holds ?b ?k) (on ?b ?s) (clear ?b)
                       (stock ?k ?more) (next ?less ?more) (tray ?k ?few) (next ?few ?many))
    :effect (and (stock ?k ?less) (tray ?k ?many)
                 (not (stock ?k ?more)) (not (tray ?k ?few))))

  ; tray -> box on the bench
  (:action give-back
    :parameters (?k ?b ?s ?less ?more ?few ?many)
    :precondition (and (working ?s) (holds ?b ?k) (on ?b ?s) (clear ?b)
                       (stock ?k ?less) (next ?less ?more) (tray ?k ?many) (next ?few ?many))
    :effect (and (stock ?k ?more) (tray ?k ?few)
                 (not (stock ?k ?less)) (not (tray ?k ?many))))

  ; tray -> the next cell of a column
  (:action show
    :parameters (?k ?c ?below ?above ?few ?many)
    :precondition (and (tray ?k ?many) (next ?few ?many)
                       (height ?c ?below) (next ?below ?above) (room ?c ?above))
    :effect (and (cell ?c ?above ?k) (height ?c ?above) (tray ?k ?few)
                 (not (height ?c ?below)) (not (tray ?k ?many))))

  ; the uppermost cell of a column -> tray
  (:action take-down
    :parameters (?k ?c ?below ?above ?few ?many)
    :precondition (and (cell ?c ?above ?k) (height ?c ?above) (next ?below ?above)
                       (tray ?k ?few) (next ?few ?many))
    :effect (and (height ?c ?below) (tray ?k ?many)
                 (not (cell ?c ?above ?k)) (not (height ?c ?above)) (not (tray ?k ?few)))))
