"""Results of gates made by hand: a value, a threshold, and a standard error where the gate has one."""

from csstsim.measure.bricks.validation.gates.record import (
    SIGMAS,
    SIGMAS_OF_MANY,
    AtLeast,
    AtMost,
    Between,
    FractionAtMost,
    Measured,
)


def at_most(name, band, value, threshold, n, sigma=0.0, sigmas=SIGMAS, **where):
    return _result(AtMost, name, sigmas, Measured(value, n, sigma), threshold, band, where)


def at_least(name, band, value, threshold, n, **where):
    return _result(AtLeast, name, SIGMAS, Measured(value, n), threshold, band, where)


def between(name, band, value, threshold, n):
    return _result(Between, name, SIGMAS_OF_MANY, Measured(value, n), threshold, band, {})


def fraction_at_most(name, value, n, threshold):
    return _result(FractionAtMost, name, SIGMAS, Measured(value, n), threshold, "all", {})


def _result(kind, name, sigmas, measured, threshold, band, where):
    gate = kind(name, scope="frame", threshold=0.0, tests="", measure=list, sigmas=sigmas)
    return gate.result(measured, threshold, band, **where)
