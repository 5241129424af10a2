"""The same over the socket: a photo with the bench that `pdcd serve` holds."""

import pdcd

try:
    with pdcd.connect(queue=True) as bench:
        run = bench.capture("white", codes=4, note="from a script")
    print(run.folder, run.manifest.owner["user"])
except ConnectionError as err:
    print(err)
