"""`csstsim init DIR`: a folder with a campaign that runs as it is, to be changed into one's own."""

from pathlib import Path

from csstsim.atomic import atomic_path
from csstsim.errors import InputError
from csstsim.shipped import ROOT

# Files of a new folder: what they are copies of, and what they are for.
FILES = {
    "campaign.yaml": ("config/starter/campaign.yaml", "what to run: exposures, chips, sky, seed"),
    "science.yaml": ("config/observations/science.yaml", "how an exposure is made: the layers, in order"),
    "survey_table.csv": ("survey_tables/demo.csv", "where the telescope points, and when"),
    "Snakefile": ("config/starter/Snakefile", "the workflow"),
    "profiles/default/config.yaml": ("profiles/default/config.yaml", "how it is run here: cores, what to do on errors"),
    "profiles/slurm/config.yaml": ("profiles/slurm/config.yaml", "... on a cluster: --workflow-profile profiles/slurm"),
    "profiles/slurm/workflow.yaml": ("profiles/slurm/workflow.yaml", "... and on its nodes"),
}


def init(folder, say):
    """Write the files of FILES into a folder, new or without any of them. Raises InputError if one is there."""
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file; give the folder to be made", file=folder)
    there = [name for name in FILES if (folder / name).exists()]
    if there:
        raise InputError("is there already, and nothing was written; give another folder", file=folder / there[0])
    for name, (source, meaning) in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(folder / name) as temporary:
            Path(temporary).write_bytes((ROOT / source).read_bytes())
        say(f"{folder / name}  {meaning}")
    say(f"\nNext:  cd {folder}\n       csstsim plan campaign.yaml\n       snakemake --cores 2")
