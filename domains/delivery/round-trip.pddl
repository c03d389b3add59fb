; One van takes two parcels out, and has to be at the depot in the end. Cost 15,
; 8 actions.
(define (problem round-trip)
  (:domain delivery)
  (:objects
    depot village farm mill - place
    red - van
    letter crate - parcel)
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
    (road depot mill) (= (length depot mill) 6)
    (road mill depot) (= (length mill depot) 6)
    (van-at red depot)
    (light letter) (light crate)
    (lies-at letter depot) (lies-at crate depot))
  (:goal (and
    (lies-at letter farm) (lies-at crate mill)
    (van-at red depot)))
  (:metric minimize (total-cost)))
