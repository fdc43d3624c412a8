"""What judges and ships the entries of the zoo: model card, export, deployment, verification."""
