"""A real Slurm of one node for tests: munged, slurmctld and slurmd on loopback, started here and ended by their pids.

The node daemon runs in its own mount namespace with a tmpfs on `scratch`: jobs write there, invisibly from outside, as
on a cluster whose nodes have their own disks. Memory is enforced (polled each second, no cgroups).
"""

import os
import shutil
import socket
import subprocess
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import psutil

CONF = Path("/etc/slurm/slurm.conf")  # Snakemake's inner srun looks nowhere else: it strips SLURM_CONF
OURS = "# of csstsim's tests"
PROGRAMS = "munged", "munge", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "scancel", "unshare", "mount"
SEARCH = os.pathsep.join([os.environ["PATH"], "/usr/sbin", "/sbin"])
CPUS, WAIT = 2, 60.0  # of the node; s that a daemon is waited for
POLLING = (  # without accounting only squeue knows of jobs; a test need not wait as long as a cluster's users
    "--slurm-status-command", "squeue", "--slurm-init-seconds-before-status-checks", "2",
    "--seconds-between-status-checks", "2", "--latency-wait", "5",
)  # fmt: skip


def why_not():
    """Return why a Slurm cannot be started here, or None."""
    missing = [name for name in PROGRAMS if shutil.which(name, path=SEARCH) is None]
    if missing:
        return f"{', '.join(missing)} not installed: apt-get install slurmctld slurmd slurm-client munge"
    if find_spec("snakemake_executor_plugin_slurm") is None:
        return "snakemake-executor-plugin-slurm not installed: pip install -e '.[slurm]'"
    if os.geteuid() != 0:
        return "only root can start slurmd for all users' jobs and mount a scratch disk"
    if CONF.exists() and not CONF.read_text().startswith(OURS):
        return f"{CONF} is of another Slurm"
    if subprocess.run(["munge", "-n"], capture_output=True, timeout=20, check=False).returncode == 0:
        return "a munged is running here"
    return None


class OneNodeSlurm:
    """The three daemons, logging into a folder. Use as a context; `scratch` is the node's own disk."""

    def __init__(self, folder):
        self.folder, self.scratch, self._daemons = folder, folder / "scratch", {}

    def __enter__(self):
        for name in ("munge", "state", "spool", "scratch"):
            (self.folder / name).mkdir(mode=0o755)
        try:
            self._start_munge()
            CONF.parent.mkdir(exist_ok=True)
            CONF.write_text(self._configuration())
            self._start("slurmctld", "-D", "-i")
            self.start_node()
            self._wait(lambda: self.ask("sinfo", "--noheader", "--format", "%t") == "idle", "the node to be idle")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        if "slurmctld" in self._daemons:
            self.ask("scancel", "--user", "root")
            self._wait(lambda: not self.ask("squeue", "--noheader"), "jobs to end", fatal=False)
        for daemon in reversed(self._daemons.values()):
            daemon.terminate()
            try:
                daemon.wait(timeout=20)
            except subprocess.TimeoutExpired:
                daemon.kill()
                daemon.wait(timeout=20)
        if CONF.exists() and CONF.read_text().startswith(OURS):
            CONF.unlink()

    def ask(self, *command):
        """Return what a Slurm command prints, "" if it fails."""
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        return done.stdout.strip() if done.returncode == 0 else ""

    def job(self, jobid):
        """Return what Slurm keeps of a job, {key: value}."""
        words = self.ask("scontrol", "--oneliner", "show", "job", str(jobid)).split()
        return dict(word.split("=", 1) for word in words if "=" in word)

    def start_node(self):
        """Start the node daemon, with an empty scratch disk."""
        mounted = f'mount -t tmpfs tmpfs "{self.scratch}" && exec slurmd -D -N {socket.gethostname()}'
        self._start("unshare", "--mount", "sh", "-c", mounted)

    def kill_node(self, jobs_too):
        """kill -9 the node daemon; `jobs_too`: and all that runs there, as when the machine dies.

        Of a machine that died the controller hears nothing for SlurmdTimeout; it is told at once.
        """
        daemon = self._daemons["unshare"]
        namespace = os.readlink(f"/proc/{daemon.pid}/ns/mnt")
        daemon.kill()
        daemon.wait()
        for process in psutil.process_iter() if jobs_too else ():
            with suppress(OSError, psutil.Error):
                if os.readlink(f"/proc/{process.pid}/ns/mnt") == namespace:
                    process.kill()
        if jobs_too:
            self.ask("scontrol", "update", f"nodename={socket.gethostname()}", "state=down", "reason=died")

    def on_node(self):
        """Return the scratch disk as the node sees it."""
        return Path(f"/proc/{self._daemons['unshare'].pid}/root{self.scratch}")

    def _start(self, program, *arguments):
        with open(self.folder / f"{program}.log", "w") as log:
            self._daemons[program] = subprocess.Popen(
                [shutil.which(program, path=SEARCH), *arguments], stdout=log, stderr=log, start_new_session=True,
                env=os.environ | {"PATH": SEARCH},
            )  # fmt: skip

    def _start_munge(self):
        Path("/run/munge").mkdir(mode=0o755, exist_ok=True)
        key, files = self.folder / "munge" / "key", self.folder / "munge"
        key.write_bytes(os.urandom(128))
        key.chmod(0o600)
        self._start(
            "munged", "--foreground", "--force", f"--key-file={key}", f"--seed-file={files / 'seed'}",
            f"--log-file={files / 'log'}", f"--pid-file={files / 'pid'}",
        )  # fmt: skip
        self._wait(lambda: self.ask("munge", "-n"), "munged")

    def _wait(self, done, what, fatal=True):
        end = time.monotonic() + WAIT
        while not done():
            dead = [name for name, daemon in self._daemons.items() if daemon.poll() is not None]
            if dead or time.monotonic() > end:
                logs = "\n".join(path.read_text()[-2000:] for path in self.folder.glob("*.log"))
                if fatal:
                    raise RuntimeError(f"waited for {what}; ended: {dead or 'none'}\n{logs}")
                return
            time.sleep(0.2)

    def _configuration(self):
        host, (control, node) = socket.gethostname(), free_ports(2)
        memory = int(0.9 * psutil.virtual_memory().total / 2**20)
        return f"""{OURS}
ClusterName=csstsim
SlurmctldHost={host}(127.0.0.1)
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
SlurmctldPort={control}
SlurmdPort={node}
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
CredType=cred/munge
MpiDefault=none
ReturnToService=2
SwitchType=switch/none
SlurmctldPidFile={self.folder}/slurmctld.pid
SlurmdPidFile={self.folder}/slurmd.pid
StateSaveLocation={self.folder}/state
SlurmdSpoolDir={self.folder}/spool
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
KillWait=5
MinJobAge=3600
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=0,sched_interval=2,bf_interval=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
DefMemPerCPU=500
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=task=1
JobAcctGatherParams=OverMemoryKill
AccountingStorageType=accounting_storage/none
SlurmdParameters=config_overrides
NodeName={host} NodeAddr=127.0.0.1 CPUs={CPUS} CoresPerSocket={CPUS} RealMemory={memory}
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


def free_ports(count):
    """Return ports of loopback that nobody listens on."""
    sockets = [socket.socket() for _ in range(count)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports
