; Two parcels for one locker, which has a key: no dead end. Both go on one tray,
; are pushed and tipped together, and sealed by one shut-door. 5 actions at
; best.
(define (problem two-parcels)
  (:domain lockers)
  (:objects
    dock wall - place
    locker-1 - locker
    tray-1 - tray
    book shoes - parcel)
  (:init
    (next-to dock wall) (next-to wall dock)
    (stands-at locker-1 wall)
    (has-key locker-1)
    (tray-at tray-1 dock)
    (parcel-at book dock) (loose book)
    (parcel-at shoes dock) (loose shoes))
  (:goal (and
    (inside book locker-1) (sealed book)
    (inside shoes locker-1) (sealed shoes))))
