; One van, six places, five parcels and a way home. Cost 20, 16 actions.
(define (problem five-parcels)
  (:domain delivery)
  (:objects
    depot village farm mill harbour inn - place
    red - van
    letter crate milk fish wine - parcel)
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
    (van-at red depot)
    (light letter) (light crate) (light milk) (light fish) (light wine)
    (lies-at letter depot) (lies-at crate village) (lies-at milk farm) (lies-at fish harbour)
    (lies-at wine inn))
  (:goal (and
    (lies-at letter farm) (lies-at crate harbour) (lies-at milk depot) (lies-at fish inn)
    (lies-at wine depot)
    (van-at red depot)))
  (:metric minimize (total-cost)))
