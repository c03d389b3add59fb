; The smallest rung: one van, one parcel, and the detour over the village is
; shorter than the direct road. Cost 5, 4 actions.
(define (problem one-parcel)
  (:domain delivery)
  (:objects
    depot village farm - place
    red - van
    letter - parcel)
  (:init
    (= (total-cost) 0)
    (road depot village) (= (length depot village) 2)
    (road village depot) (= (length village depot) 2)
    (road village farm) (= (length village farm) 3)
    (road farm village) (= (length farm village) 3)
    (road depot farm) (= (length depot farm) 7)
    (road farm depot) (= (length farm depot) 7)
    (van-at red depot)
    (light letter)
    (lies-at letter depot))
  (:goal (and
    (lies-at letter farm)))
  (:metric minimize (total-cost)))
