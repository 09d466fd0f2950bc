"""Two nodes of a Ray cluster on this machine's loopback device, for tests.

Run as a program, it starts the nodes, prints the cluster's address, and does what its input says.
So whoever tests has nothing of Ray in its own process, and nothing is left when it ends.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

STORE = 80 << 20  # of memory for objects [bytes]
# Ray reads these as it is imported; who connects to such a cluster needs them, too
VARIABLES = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",  # it listens on the loopback device only
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_AUTH_MODE": "disabled",  # else it keeps a token in the home folder
}


class TwoNodes(NamedTuple):
    """A cluster: its address, its process, and what kills the processes of its second node."""

    address: str
    process: subprocess.Popen[str]
    kill_second: Callable[[], None]


@contextmanager
def two_nodes(count: int, **of_second: str) -> Iterator[TwoNodes]:
    """Have a cluster inside.

    Args:
        count: how many CPUs each node has.
        of_second: variables in the environment of the second node.
    """
    variables = [f"{name}={value}" for name, value in of_second.items()]
    with subprocess.Popen(
        [sys.executable, __file__, str(count), *variables],
        env={**os.environ, **VARIABLES},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        answers = process.stdout

        def kill() -> None:
            print("kill", file=process.stdin, flush=True)
            assert answers.readline() == "killed\n"

        address = answers.readline().strip()
        assert address, "the cluster did not start"
        yield TwoNodes(address, process, kill)


def main() -> None:
    """Start the nodes, and do what is said."""
    from ray.cluster_utils import Cluster  # as VARIABLES are set

    os.makedirs(f"{tempfile.gettempdir()}/ray", exist_ok=True)  # Ray notes the address there
    count, variables = int(sys.argv[1]), dict(pair.split("=", 1) for pair in sys.argv[2:])
    folder = tempfile.mkdtemp(prefix="navbake-ray-", dir="/tmp")  # short, as paths of sockets are
    # a busy machine takes longer than Ray waits for a node by itself
    common = {
        "num_cpus": count,
        "object_store_memory": STORE,
        "include_dashboard": False,
        "wait": False,
    }
    cluster = Cluster(initialize_head=True, head_node_args={**common, "temp_dir": folder})
    try:
        second = cluster.add_node(env_vars=variables, **common)
        cluster.wait_for_nodes(timeout=300)
        print(cluster.address, flush=True)
        for _ in sys.stdin:
            cluster.remove_node(second, allow_graceful=False)
            print("killed", flush=True)
    finally:
        cluster.shutdown()
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
