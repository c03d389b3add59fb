; Two trays, one for each of two lockers, no keys, four parcels. Dead ends. 10
; actions at best.
(define (problem two-trays)
  (:domain lockers)
  (:objects
    dock wall - place
    locker-1 locker-2 - locker
    tray-1 tray-2 - tray
    book shoes lamp toy - parcel)
  (:init
    (next-to dock wall) (next-to wall dock)
    (stands-at locker-1 wall) (stands-at locker-2 wall)
    (tray-at tray-1 dock) (tray-at tray-2 dock)
    (parcel-at book dock) (loose book)
    (parcel-at shoes dock) (loose shoes)
    (parcel-at lamp dock) (loose lamp)
    (parcel-at toy dock) (loose toy))
  (:goal (and
    (inside book locker-1) (sealed book)
    (inside shoes locker-1) (sealed shoes)
    (inside lamp locker-2) (sealed lamp)
    (inside toy locker-2) (sealed toy))))
