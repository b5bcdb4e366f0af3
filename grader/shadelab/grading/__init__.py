"""The way of a submission: plan, questions, answers, judgement, result."""
