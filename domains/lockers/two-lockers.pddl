; Two parcels for two lockers at one wall, neither with a key: tipping the tray
; with both on it, and shutting the door, seals the wrong one in. Dead ends. 9
; actions at best.
(define (problem two-lockers)
  (:domain lockers)
  (:objects
    dock wall - place
    locker-1 locker-2 - locker
    tray-1 - tray
    book shoes - parcel)
  (:init
    (next-to dock wall) (next-to wall dock)
    (stands-at locker-1 wall) (stands-at locker-2 wall)
    (tray-at tray-1 dock)
    (parcel-at book dock) (loose book)
    (parcel-at shoes dock) (loose shoes))
  (:goal (and
    (inside book locker-1) (sealed book)
    (inside shoes locker-2) (sealed shoes))))
