"""Collection of pixel trajectories, the data set on disk, augmentation and the LightningDataModules."""
