"""Run `snakemake --lint` and fail on what it finds, but for one complaint.

Snakemake wants a conda environment or container named in each rule. The software of every rule is this
package, pinned by requirements.lock and installed by `make`; a second, unpinned list would only drift.
"""

import re
import subprocess
import sys

ALLOWED = "Specify a conda environment or container for each rule"

done = subprocess.run(["snakemake", "--lint", *sys.argv[1:]], capture_output=True, text=True, check=False)
text = done.stdout + done.stderr
lints = re.findall(r"^    \* (.*):$", text, re.MULTILINE)
if any(lint != f"{ALLOWED}." for lint in lints) or (done.returncode and not lints):
    print(text)
    sys.exit(1)
