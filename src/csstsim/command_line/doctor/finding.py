"""The result of a check of `csstsim doctor`."""

from dataclasses import dataclass

OK = "ok"
WARNING = "warning"
PROBLEM = "problem"


@dataclass(frozen=True)
class Finding:
    """The result of one check. verdict: OK, WARNING or PROBLEM; text: the state and, unless it is OK, what to do."""

    verdict: str
    what: str
    text: str
