"""What is fitted on a frozen encoder when a fit ends: centring, predictor, probe, decoder, codec ranges."""
