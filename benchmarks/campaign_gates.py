"""A campaign run to its report: the value, error and margin of each gate, and the CPU seconds of its jobs.

    python benchmarks/campaign_gates.py config/campaign.yaml

Snakemake makes what is not made yet; a campaign that is finished takes seconds. Of the gates of one name and band, the
one nearest to failing counts. `make evidence` compares the values with the last ones: one that moved by more than its
error is printed even where the gate passes. Exit code 1 if a gate fails.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

from evidence import ROOT
from evidence.record import Record

from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.running.run_times import run_times
from csstsim.measure.bricks.validation.verdict import headline


def made(file: Path, *settings: str) -> OpenCampaign:
    """Make a campaign; return it. Ends the program if that fails."""
    program = Path(sys.executable).parent / "snakemake"
    words = [program, "--profile", ROOT / "profiles/default", "--config", f"campaign={file}", *settings]
    code = subprocess.run([str(word) for word in words], cwd=ROOT).returncode
    if code:
        sys.exit(f"the campaign {file} was not made: exit code {code}")
    return OpenCampaign(file)


def key_of(gate: dict) -> str:
    """Return the key of a gate in the record: its name and band in letters, digits and underscores."""
    text = f"{gate['name']} {gate['band']}".replace("'", "").lower()
    return "_".join("".join(c if c.isalnum() else " " for c in text).split())


def report_gates(verdict: dict, record: Record) -> None:
    """Record the gate nearest to failing of each name and band, and the table of all."""
    nearest: dict[str, dict] = {}
    for gate in verdict["gates"]:
        if gate["passed"] is not None:
            known = nearest.setdefault(key_of(gate), gate)
            if gate["margin"] > known["margin"]:
                nearest[key_of(gate)] = gate
    for key, gate in nearest.items():
        what = f"{gate['name']} in {gate['band']}"
        record.value(key, float(gate["value"]), what, error=gate["error"], goal=gate["passed"])
    rows = []
    for name in dict.fromkeys(gate["name"] for gate in nearest.values()):
        gates = [gate for gate in nearest.values() if gate["name"] == name]
        worst = max(gates, key=lambda gate: gate["margin"])
        value, margin = f"{worst['value']:.3g}", f"{worst['margin']:.2f}"
        rows.append([name, len(gates), value, worst["band"], worst["threshold"], margin])
    record.table("margins", ["gate", "bands", "value nearest to failing", "in", "threshold", "margin"], rows)


def main() -> None:
    """Run the campaign and record its gates."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", type=Path)
    with Record(parser) as record:
        file = record.options.campaign.resolve()
        if record.toy:
            file = toy_campaign(record.results / "campaign_gates")
        run = made(file, *(["chips=exposure"] if record.toy else []))
        verdict = json.loads(run.paths.report.with_name("verdict.json").read_text())
        counts = verdict["counts"]
        print(headline(verdict))
        record.value("gates", counts["pass"] + counts["fail"], "gates that could be evaluated")
        record.value("failed", counts["fail"], "gates that fail", below=0)
        record.value("not_evaluated", counts["not evaluated"], "gates that could not be evaluated")
        report_gates(verdict, record)
        total = next((row for row in run_times(run) if row["step"] == "all"), None)
        if total:
            record.value("cpu", total["CPU [s]"], "all jobs of the campaign", unit="CPU-s")
            record.value("cpu_over_expected", total["mean / expected"], "the same over that of `csstsim plan`")


def toy_campaign(folder: Path) -> Path:
    """Write a campaign of seconds: five windows of one r chip with stars and galaxies; return its file."""
    from support.star_galaxy_field import write_field

    return write_field(folder, 1)


if __name__ == "__main__":
    main()
