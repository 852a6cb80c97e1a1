"""Print the number of hostile files given to each reader."""

from fuzz.trial import TALLIES


def pytest_terminal_summary(terminalreporter, config):
    if not TALLIES or "slow" not in (config.option.markexpr or "").replace("not slow", ""):
        return
    terminalreporter.write_line("\n| reader | tried | read | refused | faults |\n|---|---|---|---|---|")
    rows = [(name, tally.total(), tally["read"], tally["refused"], tally["fault"]) for name, tally in TALLIES.items()]
    rows.append(("all", *(sum(row[i] for row in rows) for i in range(1, 5))))
    for row in rows:
        terminalreporter.write_line(f"| {' | '.join(map(str, row))} |")
