; The smallest rung: one parcel, one tray, one locker without a key. Shutting
; the locker while it is empty is a dead end. 4 actions at best.
(define (problem one-parcel)
  (:domain lockers)
  (:objects
    dock wall - place
    locker-1 - locker
    tray-1 - tray
    book - parcel)
  (:init
    (next-to dock wall) (next-to wall dock)
    (stands-at locker-1 wall)
    (tray-at tray-1 dock)
    (parcel-at book dock) (loose book))
  (:goal (and
    (inside book locker-1) (sealed book))))
