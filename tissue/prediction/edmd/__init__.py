"""Extended dynamic mode decomposition: dictionaries, regression, validation, stored predictors."""
