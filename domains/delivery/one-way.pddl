; Two vans, five places, three parcels, one of them heavy; the road down to the
; harbour is one-way, so that a van or a parcel that went there is lost to all
; others. Dead ends. Cost 19, 13 actions.
(define (problem one-way)
  (:domain delivery)
  (:objects
    depot village farm mill harbour - place
    red blue - van
    letter safe fish - parcel)
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
    (road mill harbour) (= (length mill harbour) 1)
    (van-at red depot) (van-at blue mill)
    (light letter) (light fish)
    (lies-at letter depot) (lies-at safe farm) (lies-at fish mill))
  (:goal (and
    (lies-at letter mill) (lies-at safe depot) (lies-at fish harbour)))
  (:metric minimize (total-cost)))
