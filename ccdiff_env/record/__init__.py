"""Records of episodes: rollouts, certificates, banks, and counterfactuals of running ones."""
