"""Run `snakemake --lint` and fail for every complaint except two.

Snakemake wants a conda environment or container for each rule. The software of all rules is this package, pinned by
requirements.lock and installed by `make`. Snakemake also wants the path of the campaign as a parameter of each rule.
Recipes represent the content of the campaign, so that a campaign can be moved without repeating its jobs.
"""

import re
import subprocess
import sys

ALLOWED = (
    "Specify a conda environment or container for each rule.",
    "Shell command directly uses variable CAMPAIGN from outside of the rule",
)

done = subprocess.run(["snakemake", "--lint", *sys.argv[1:]], capture_output=True, text=True, check=False)
text = done.stdout + done.stderr
lints = re.findall(r"^    \* (.*):$", text, re.MULTILINE)
if not set(lints) <= set(ALLOWED) or (done.returncode and not lints):
    print(text)
    sys.exit(1)
