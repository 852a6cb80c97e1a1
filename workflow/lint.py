"""Run `snakemake --lint` and fail on what it finds, but for one complaint.

Snakemake wants a conda environment or container named in each rule. The software of every rule is this
package, pinned by requirements.lock and installed by `make`; a second, unpinned list would only drift. And it wants the
campaign's path as a parameter: recipes stand for the content, and a campaign that was moved need not be made again.
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
