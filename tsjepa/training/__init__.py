"""LightningModules, one per thing trained, with their losses and callbacks."""
