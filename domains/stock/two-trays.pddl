; Two trays share two bins, which are too small for both orders at once.
(define (problem two-trays)
  (:domain stock)
  (:objects bolt nut - kind bin-bolt bin-nut - bin tray-1 tray-2 - tray)
  (:init
    (= (total-cost) 0)
    (holds bin-bolt bolt) (= (parts bin-bolt) 3) (= (size bin-bolt) 4) (= (packs bin-bolt) 1) (= (pack bin-bolt) 2)
    (holds bin-nut nut) (= (parts bin-nut) 2) (= (size bin-nut) 4) (= (packs bin-nut) 1) (= (pack bin-nut) 3)
    (= (placed bolt tray-1) 0) (= (ordered bolt tray-1) 2) (= (room bolt tray-1) 3)
    (= (placed nut tray-1) 0) (= (ordered nut tray-1) 1) (= (room nut tray-1) 2)
    (= (placed bolt tray-2) 0) (= (ordered bolt tray-2) 2) (= (room bolt tray-2) 3)
    (= (placed nut tray-2) 0) (= (ordered nut tray-2) 2) (= (room nut tray-2) 3))
  (:goal (and (sent tray-1) (sent tray-2)))
  (:metric minimize (total-cost)))
