"""The pages of the papers: tables, figures and words made of what the experiments found."""
