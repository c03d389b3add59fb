; The largest rung: two vans, six places, five parcels, of which the piano is
; heavy. Cost 25, 18 actions.
(define (problem two-vans)
  (:domain delivery)
  (:objects
    depot village farm mill harbour inn - place
    red blue - van
    letter crate piano fish wine - parcel)
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
    (road depot inn) (= (length depot inn) 5)
    (road inn depot) (= (length inn depot) 5)
    (road inn harbour) (= (length inn harbour) 5)
    (road harbour inn) (= (length harbour inn) 5)
    (van-at red depot) (van-at blue harbour)
    (light letter) (light crate) (light fish) (light wine)
    (lies-at letter depot) (lies-at crate village) (lies-at piano farm) (lies-at fish harbour)
    (lies-at wine inn))
  (:goal (and
    (lies-at letter farm) (lies-at crate harbour) (lies-at piano depot) (lies-at fish inn)
    (lies-at wine depot)))
  (:metric minimize (total-cost)))
