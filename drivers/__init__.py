"""Device drivers, one file or folder each; `pdcd.bench.registry` is the table that names them."""
