"""The run folder and the record of a run: manifest, shots, frame log, ledger."""
