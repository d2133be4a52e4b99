"""`yesnt trade`: what each stage's speed settings cost in accuracy on a shot, and the cheapest that will do."""

from yesnt.measure.trade.run import TradeOptions, run_trade

__all__ = ["TradeOptions", "run_trade"]
