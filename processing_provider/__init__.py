"""The Processing provider: parameters in, one engine stage run, layers out. No mathematics here."""
