; One van, five places, three parcels that lie in three different places. Cost
; 17, 12 actions.
(define (problem three-parcels)
  (:domain delivery)
  (:objects
    depot village farm mill harbour - place
    red - van
    letter crate milk - parcel)
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
    (road mill harbour) (= (length mill harbour) 1)
    (road harbour mill) (= (length harbour mill) 1)
    (van-at red depot)
    (light letter) (light crate) (light milk)
    (lies-at letter depot) (lies-at crate village) (lies-at milk farm))
  (:goal (and
    (lies-at letter farm) (lies-at crate harbour) (lies-at milk depot)))
  (:metric minimize (total-cost)))
