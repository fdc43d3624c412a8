"""Physical systems: dynamics, pictures, scores and experts; neither TorchRL nor Lightning is imported here."""
