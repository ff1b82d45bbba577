"""The contract suite of makes: what every driver must do, judged by the ground truth of its simulator."""
