"""A process of the test of data parallelism: fits recipes together with its peer, one after the other.

Its rank stands in the environment, where Lightning looks for it.
"""

import sys

from torch import distributed

from tsjepa import cli

if __name__ == "__main__":
    for recipe in sys.argv[1:]:
        if status := cli.main(["fit", "--config", recipe, "--trust"]):
            sys.exit(status)
    distributed.barrier()  # gloo aborts a process whose peer is gone already
    distributed.destroy_process_group()
