"""The one ring estimator: measurements of a shot -> maximum-likelihood ring, judged and with covariance."""
