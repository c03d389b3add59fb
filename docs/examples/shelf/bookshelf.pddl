; The deep board belongs at the bottom and the short one on top, but each fits elsewhere as well.
(define (problem bookshelf) (:domain shelf)
  (:objects deep plain short - board bottom middle top - height)
  (:init (on-floor deep) (on-floor plain) (on-floor short) (free bottom) (free middle) (free top)
    (fits deep bottom) (fits deep middle) (fits plain bottom) (fits plain middle) (fits plain top)
    (fits short middle) (fits short top))
  (:goal (and (set-at deep bottom) (screwed deep) (set-at plain middle) (screwed plain)
    (set-at short top) (screwed short) (not (driver-in-hand)))))
