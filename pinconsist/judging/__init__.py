"""The referee: how wrong the motion and the loop forces of other simulators are, and of logs.

Read judge.py first (the public function and its result), then reference.py (what is taken as true, and the errors),
motion.py (the law that all follow), contestants.py with mjcf.py (MuJoCo, Pinocchio, and this package), log.py (a log of
any simulator), and report.py (the table and the page).
"""
