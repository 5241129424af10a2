"""Device drivers, one file or folder each; `pdcd.registry` is the table that names them."""
