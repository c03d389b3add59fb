; The lockers of two-lockers.pddl with three parcels and a key to each of them:
; every mistake can be undone, at a price. No dead ends. 10 actions at best.
(define (problem keys)
  (:domain lockers)
  (:objects
    dock wall - place
    locker-1 locker-2 - locker
    tray-1 - tray
    book shoes lamp - parcel)
  (:init
    (next-to dock wall) (next-to wall dock)
    (stands-at locker-1 wall) (stands-at locker-2 wall)
    (has-key locker-1) (has-key locker-2)
    (tray-at tray-1 dock)
    (parcel-at book dock) (loose book)
    (parcel-at shoes dock) (loose shoes)
    (parcel-at lamp dock) (loose lamp))
  (:goal (and
    (inside book locker-1) (sealed book)
    (inside shoes locker-2) (sealed shoes)
    (inside lamp locker-2) (sealed lamp))))
