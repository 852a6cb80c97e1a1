"""What a check found."""

from dataclasses import dataclass

OK, WARNING, PROBLEM = "ok", "warning", "problem"


@dataclass(frozen=True)
class Finding:
    """What one check found. verdict: OK, WARNING or PROBLEM; text: what is there and, if it is not OK, what to do."""

    verdict: str
    what: str
    text: str
