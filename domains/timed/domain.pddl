; An assembly cell in minutes. A person walks between places at a known speed, takes
; parts from shelves, fastens them at the bench, and charges the screwdriver, which
; lasts for a few fastenings. One person does one action after the other.
(define (domain timed)
  (:requirements :typing :durative-actions :numeric-fluents :negative-preconditions)
  (:types place part)
  (:constants bench dock - place frame - part)
  (:predicates
    (person-at ?x - place)                ; where the person is
    (lies-at ?p - part ?x - place)        ; the part lies there
    (held ?p - part)                      ; the part is in the person's hands
    (free)                                ; the person's hands are free
    (fastened ?p - part)                  ; the part is fastened
    (onto ?p ?q - part))                  ; static: p is fastened onto q
  (:functions
    (distance ?x ?y - place)              ; static, metres
    (speed)                               ; static, metres a minute
    (handling ?p - part)                  ; static, minutes
    (charge)                              ; fastenings that the screwdriver lasts for
    (full))                               ; static: fastenings of a full charge

  (:durative-action walk
    :parameters (?x ?y - place)
    :duration (= ?duration (/ (distance ?x ?y) (speed)))
    :condition (and (at start (person-at ?x)))
    :effect (and (at start (not (person-at ?x))) (at end (person-at ?y))))

  (:durative-action take
    :parameters (?p - part ?x - place)
    :duration (= ?duration (handling ?p))
    :condition (and (at start (lies-at ?p ?x)) (at start (free)) (over all (person-at ?x)))
    :effect (and (at start (not (lies-at ?p ?x))) (at start (not (free))) (at end (held ?p))))

  (:durative-action put
    :parameters (?p - part ?x - place)
    :duration (= ?duration 0.25)
    :condition (and (at start (held ?p)) (over all (person-at ?x)))
    :effect (and (at start (not (held ?p))) (at end (lies-at ?p ?x)) (at end (free))))

  (:durative-action fasten
    :parameters (?p ?q - part)
    :duration (= ?duration (* 1.5 (handling ?p)))
    :condition (and (at start (onto ?p ?q)) (at start (fastened ?q)) (at start (lies-at ?p bench))
                    (at start (free)) (over all (person-at bench)) (at start (>= (charge) 1)))
    :effect (and (at start (not (lies-at ?p bench))) (at end (fastened ?p)) (at end (decrease (charge) 1))))

  (:durative-action recharge
    :parameters ()
    :duration (= ?duration 3.5)
    :condition (and (at start (free)) (over all (person-at dock)))
    :effect (at end (assign (charge) (full)))))
