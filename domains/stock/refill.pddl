; Two kinds on one tray; the nuts do not suffice, and a pack fits only into an emptier bin.
(define (problem refill)
  (:domain stock)
  (:objects bolt nut - kind bin-bolt bin-nut - bin tray-1 - tray)
  (:init
    (= (total-cost) 0)
    (holds bin-bolt bolt) (= (parts bin-bolt) 4) (= (size bin-bolt) 6) (= (packs bin-bolt) 1) (= (pack bin-bolt) 3)
    (holds bin-nut nut) (= (parts bin-nut) 2) (= (size bin-nut) 4) (= (packs bin-nut) 2) (= (pack bin-nut) 3)
    (= (placed bolt tray-1) 0) (= (ordered bolt tray-1) 2) (= (room bolt tray-1) 3)
    (= (placed nut tray-1) 0) (= (ordered nut tray-1) 3) (= (room nut tray-1) 4))
  (:goal (and (sent tray-1)))
  (:metric minimize (total-cost)))
