"""What a late engine will have done: Smith's predictor, state predictors."""
