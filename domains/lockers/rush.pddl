; The largest rung: two walls, no keys and five parcels, one of which waits at
; the wall where it does not belong. Dead ends. 12 actions at best.
(define (problem rush)
  (:domain lockers)
  (:objects
    dock wall-1 wall-2 - place
    locker-1 locker-2 - locker
    tray-1 tray-2 - tray
    book shoes lamp toy mug - parcel)
  (:init
    (next-to dock wall-1) (next-to wall-1 dock) (next-to dock wall-2) (next-to wall-2 dock)
    (stands-at locker-1 wall-1) (stands-at locker-2 wall-2)
    (tray-at tray-1 dock) (tray-at tray-2 dock)
    (parcel-at book dock) (loose book)
    (parcel-at shoes dock) (loose shoes)
    (parcel-at lamp dock) (loose lamp)
    (parcel-at toy dock) (loose toy)
    (parcel-at mug wall-1) (loose mug))
  (:goal (and
    (inside book locker-1) (sealed book)
    (inside shoes locker-1) (sealed shoes)
    (inside lamp locker-2) (sealed lamp)
    (inside toy locker-2) (sealed toy)
    (inside mug locker-2) (sealed mug))))
