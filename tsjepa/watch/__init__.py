"""A running fleet as a web page on this machine: pictures, beliefs, and sliders that change the run."""
