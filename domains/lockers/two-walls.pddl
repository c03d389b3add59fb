; Two walls with a locker each, on either side of the dock, and four parcels;
; only locker-2 has a key. Dead ends. 10 actions at best.
(define (problem two-walls)
  (:domain lockers)
  (:objects
    dock wall-1 wall-2 - place
    locker-1 locker-2 - locker
    tray-1 tray-2 - tray
    book shoes lamp toy - parcel)
  (:init
    (next-to dock wall-1) (next-to wall-1 dock) (next-to dock wall-2) (next-to wall-2 dock)
    (stands-at locker-1 wall-1) (stands-at locker-2 wall-2)
    (has-key locker-2)
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
