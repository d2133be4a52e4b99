"""Plans a run: graph of nodes, stage table, settings, chunks and exchange sweeps. Nothing runs here."""
