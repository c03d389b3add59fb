; Two vans; the piano and the safe are heavy, so both vans have to be where they
; are loaded. Here the disjunctive precondition changes with the state. Cost 24,
; 14 actions.
(define (problem heavy)
  (:domain delivery)
  (:objects
    depot village farm mill - place
    red blue - van
    letter piano safe - parcel)
  (:init
    (= (total-cost) 0)
    (road depot village) (= (length depot village) 2)
    (road village depot) (= (length village depot) 2)
    (road village farm) (= (length village farm) 3)
    (road farm village) (= (length farm village) 3)
    (road depot farm) (= (length depot farm) 7)
    (road farm depot) (= (length farm depot) 7)
    (road farm mill) (= (length farm mill) 4)
    (road mill farm) (= (length mill farm) 4)
    (van-at red depot) (van-at blue mill)
    (light letter)
    (lies-at letter depot) (lies-at piano village) (lies-at safe farm))
  (:goal (and
    (lies-at letter mill) (lies-at piano farm) (lies-at safe depot)))
  (:metric minimize (total-cost)))
