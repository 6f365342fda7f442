"""Reading ahead and writing behind: order, bounds, and errors once and in order."""

import contextlib
import threading

import pytest

from stillray.batch.read_ahead import run_overlapped


class Bench:
    """Stages that note what they did and can be told to fail."""

    def __init__(self, **fail_at):
        self.fail_at = fail_at
        self.read_items, self.written, self.reported = [], [], []

    def read(self, item):
        self.read_items.append(item)
        self._maybe_fail("read", item)
        return item * 10

    def work(self, item, value):
        assert value == item * 10
        self._maybe_fail("work", item)
        return value + 1

    def write(self, item, result):
        assert result == item * 10 + 1
        self._maybe_fail("write", item)
        self.written.append(item)
        return result

    def report(self, item, written):
        self.reported.append((item, written))

    def _maybe_fail(self, stage, item):
        if self.fail_at.get(stage) == item:
            error = self.fail_at.get("kind", ValueError)
            raise error(f"{stage} {item}")

    def run(self, count=8, **options):
        run_overlapped(range(count), self.read, self.work, self.write, self.report, **options)


def test_every_item_is_done_in_order():
    bench = Bench()
    bench.run(9)
    assert bench.written == list(range(9))
    assert bench.reported == [(i, i * 10 + 1) for i in range(9)]


def test_no_items_is_nothing_to_do():
    bench = Bench()
    bench.run(0)
    assert bench.reported == []


@pytest.mark.parametrize("stage", ["read", "work"])
@pytest.mark.parametrize("kind", [ValueError, KeyboardInterrupt])
def test_failure_comes_after_everything_before_it_was_written(stage, kind):
    bench = Bench(**{stage: 5, "kind": kind})
    with pytest.raises(kind, match=f"{stage} 5"):
        bench.run()
    assert bench.written == [0, 1, 2, 3, 4]
    assert [item for item, _ in bench.reported] == [0, 1, 2, 3, 4]


def test_failure_to_write_ends_the_run_there():
    bench = Bench(write=3)
    with pytest.raises(ValueError, match="write 3"):
        bench.run()
    assert [item for item, _ in bench.reported] == [0, 1, 2]
    assert max(bench.read_items) <= 3 + 2 + 2 + 1  # waiting writes, reads ahead, one at work


def test_of_two_failures_that_of_the_earlier_item_is_raised():
    bench = Bench(write=3, read=4)
    with pytest.raises(ValueError, match="write 3"):
        bench.run()


def test_no_thread_is_left_behind():
    before = threading.active_count()
    for bench in (Bench(), Bench(read=2), Bench(write=2)):
        with contextlib.suppress(ValueError):
            bench.run()
    assert threading.active_count() == before


@pytest.mark.parametrize("ahead", [1, 3])
def test_no_more_is_held_than_allowed(ahead):
    held, most = 0, 0
    lock = threading.Lock()

    def change(by):
        nonlocal held, most
        with lock:
            held += by
            most = max(most, held)

    def read(item):
        change(+1)

    def write(item, result):
        change(-1)

    run_overlapped(range(40), read, lambda item, _: None, write, lambda *_: None, ahead=ahead)
    assert held == 0
    assert most <= 2 * ahead + 1  # read ahead, at work, waiting to be written


def test_reading_goes_on_while_there_is_work():
    read_next = threading.Event()

    def read(item):
        if item == 1:
            read_next.set()
        return item

    def work(item, value):
        # would wait forever if the next item were read after this one is worked on
        assert read_next.wait(30)

    run_overlapped(range(2), read, work, lambda *_: None, lambda *_: None)


def test_work_goes_on_while_there_is_writing():
    worked_on_next = threading.Event()

    def work(item, value):
        if item == 1:
            worked_on_next.set()

    def write(item, result):
        assert worked_on_next.wait(30)

    run_overlapped(range(2), lambda item: item, work, write, lambda *_: None)
