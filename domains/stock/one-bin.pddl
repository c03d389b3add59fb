; One bin of three parts, and one tray that needs two.
(define (problem one-bin)
  (:domain stock)
  (:objects bolt - kind bin-bolt - bin tray-1 - tray)
  (:init
    (= (total-cost) 0)
    (holds bin-bolt bolt) (= (parts bin-bolt) 3) (= (size bin-bolt) 3) (= (packs bin-bolt) 0) (= (pack bin-bolt) 1)
    (= (placed bolt tray-1) 0) (= (ordered bolt tray-1) 2) (= (room bolt tray-1) 3))
  (:goal (and (sent tray-1)))
  (:metric minimize (total-cost)))
