"""What every room uses: files, journals, worker processes, checks, the choice of GL, provenance, trust, recipes."""
