//! Jobs with a clock that the test moves.

use std::sync::atomic::{AtomicU64, Ordering};

use tokio::sync::oneshot;

use super::super::deadline::within;
use super::*;

type Made = Result<u64, Problem>;

const CALL: Duration = Duration::from_secs(30);

fn jobs(kept: Duration) -> (Jobs<&'static str, u64>, CancellationToken) {
    let stopping = CancellationToken::new();
    (Jobs::new("the sum", kept, stopping.clone()), stopping)
}

/// A job that ends when the test says so.
fn held() -> (
    oneshot::Sender<Made>,
    impl FnOnce(Progress) -> futures::future::BoxFuture<'static, Made>,
) {
    let (end, ended) = oneshot::channel();
    (end, |progress: Progress| {
        Box::pin(async move {
            progress.begin("parts added", 10);
            progress.add(3);
            ended.await.expect("the test ends it")
        })
    })
}

fn never(_: Progress) -> futures::future::BoxFuture<'static, Made> {
    panic!("it goes on already")
}

async fn asked(jobs: &Jobs<&'static str, u64>) -> Made {
    within(Deadline::after(CALL), jobs.ask("key", never))
        .await
        .expect("in time")
}

#[tokio::test(start_paused = true)]
async fn one_job_answers_all_who_ask() {
    let (jobs, _stopping) = jobs(Duration::ZERO);
    let (end, make) = held();
    let asking = async {
        tokio::task::yield_now().await;
        end.send(Ok(7)).expect("it waits");
    };
    let told = tokio::join!(
        jobs.ask("key", make),
        jobs.ask("key", never),
        jobs.ask("key", never),
        asking
    );
    assert_eq!((told.0, told.1, told.2), (Ok(7), Ok(7), Ok(7)));
    assert_eq!(
        jobs.ask("key", |_| async { Ok(8) }).await,
        Ok(8),
        "another is made for who asks later"
    );
}

#[tokio::test(start_paused = true)]
async fn who_cannot_wait_is_told_how_far_it_is_and_finds_it_further_on() {
    let (jobs, _stopping) = jobs(Duration::ZERO);
    let (end, make) = held();
    let began = Instant::now();
    let refused = within(Deadline::after(CALL), jobs.ask("key", make))
        .await
        .expect("in time")
        .expect_err("slow");
    assert_eq!(
        began.elapsed(),
        Duration::from_secs(25),
        "five seconds before its deadline"
    );
    assert_eq!(
        (refused.kind, refused.reason),
        (ErrorKind::Unavailable, "STILL_WORKING")
    );
    assert_eq!(
        refused.message,
        "the sum is still being made: 3 of 10 parts added; it goes on, ask again"
    );
    assert_eq!(
        refused.details,
        [("done", "3".to_owned()), ("total", "10".to_owned())]
    );
    assert!(refused.retry_after.is_some());

    let again = tokio::spawn({
        let jobs = jobs.clone();
        async move { asked(&jobs).await }
    });
    tokio::time::sleep(Duration::from_secs(1)).await;
    end.send(Ok(7)).expect("it goes on");
    assert_eq!(again.await.expect("it ends"), Ok(7));
}

#[tokio::test]
async fn what_fails_by_the_stop_is_not_asked_what_it_says() {
    let (jobs, stopping) = jobs(Duration::ZERO);
    let goes_on = Arc::new(AtomicU64::new(0));
    let (stop, noted) = (stopping.clone(), goes_on.clone());
    let make = |_| async move {
        stop.cancelled().await;
        noted.store(1, Ordering::Relaxed);
        Err(Problem::new(
            ErrorKind::Internal,
            "INTERNAL",
            "the pool is closed",
        ))
    };
    let asking = async {
        tokio::task::yield_now().await;
        stopping.cancel();
    };
    let (told, ()) = tokio::join!(jobs.ask("key", make), asking);
    assert_eq!(told.expect_err("it stops").reason, "STOPPING");
    assert_eq!(goes_on.load(Ordering::Relaxed), 0);
}

#[tokio::test(start_paused = true)]
async fn who_waits_for_another_job_is_as_far_as_that_one() {
    let (jobs, _stopping) = jobs(Duration::ZERO);
    let (end, make) = held();
    let both = jobs.clone();
    let make = |progress: Progress| async move {
        let sum = both.ask_for(&progress, "first", make).await?;
        progress.begin("sums doubled", 4);
        Ok(2 * sum)
    };
    let slow = within(Deadline::after(CALL), jobs.ask("key", make))
        .await
        .expect("in time")
        .expect_err("slow");
    assert_eq!(
        slow.message,
        "the sum is still being made: 3 of 10 parts added; it goes on, ask again"
    );
    end.send(Ok(7)).expect("it goes on");
    assert_eq!(jobs.ask("key", never).await, Ok(14));
}

#[tokio::test(start_paused = true)]
async fn what_nobody_was_told_is_kept_for_who_comes_back_once() {
    let (jobs, _stopping) = jobs(Duration::from_secs(60));
    for wait in [59, 61] {
        let (end, make) = held();
        within(Deadline::after(CALL), jobs.ask("key", make))
            .await
            .expect("in time")
            .expect_err("slow");
        end.send(Ok(7)).expect("it goes on");
        tokio::time::sleep(Duration::from_secs(wait)).await;
        let expected = if wait == 59 { 7 } else { 8 };
        assert_eq!(
            jobs.ask("key", |_| async { Ok(8) }).await,
            Ok(expected),
            "after {wait} seconds"
        );
        assert_eq!(
            jobs.ask("key", |_| async { Ok(9) }).await,
            Ok(9),
            "it was told already"
        );
    }
}

#[tokio::test(start_paused = true)]
async fn a_job_goes_on_without_anybody_until_it_is_abandoned() {
    let (jobs, _stopping) = jobs(Duration::ZERO);
    let (end, make) = held();
    jobs.begin("key", make);
    tokio::time::sleep(ABANDONED - Duration::from_secs(1)).await;
    assert_eq!(
        asked(&jobs).await.expect_err("slow").reason,
        "STILL_WORKING"
    );
    // Asking began another while.
    tokio::time::sleep(ABANDONED - Duration::from_secs(1)).await;
    assert!(!end.is_closed());
    tokio::time::sleep(ABANDONED).await;
    assert!(end.is_closed(), "what it waited for was dropped");
    assert_eq!(jobs.ask("key", |_| async { Ok(8) }).await, Ok(8));
}

#[tokio::test(start_paused = true)]
async fn jobs_end_with_the_service() {
    let (jobs, stopping) = jobs(Duration::from_secs(60));
    let (end, make) = held();
    let asking = tokio::spawn({
        let jobs = jobs.clone();
        async move { jobs.ask("key", make).await }
    });
    tokio::task::yield_now().await;
    stopping.cancel();
    assert_eq!(
        asking.await.expect("it ends").expect_err("stopped").reason,
        "STOPPING"
    );
    assert!(end.is_closed());
}

#[tokio::test(start_paused = true)]
async fn a_failure_is_told_and_not_kept() {
    let (jobs, _stopping) = jobs(Duration::from_secs(60));
    let failed = Problem::new(ErrorKind::Internal, "INTERNAL", "no");
    let make = {
        let failed = failed.clone();
        move |_| async move { Err::<u64, _>(failed) }
    };
    assert_eq!(jobs.ask("key", make).await, Err(failed));
    let panicking = jobs.ask("key", |_| async { panic!("on purpose") }).await;
    assert_eq!(
        panicking.expect_err("it panicked").kind,
        ErrorKind::Internal
    );
    assert_eq!(jobs.ask("key", |_| async { Ok(8) }).await, Ok(8));
}

#[tokio::test(start_paused = true)]
async fn who_asks_for_many_and_leaves_keeps_a_few() {
    let jobs: Jobs<usize, u64> = Jobs::new("the sum", Duration::ZERO, CancellationToken::new());
    let (ends, makes): (Vec<_>, Vec<_>) = (0..10).map(|_| held()).unzip();
    for (key, make) in makes.into_iter().enumerate() {
        jobs.begin(key, make);
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    assert_eq!(jobs.ask(10, |_| async { Ok(7) }).await, Ok(7));
    tokio::time::sleep(Duration::from_millis(1)).await;
    let going_on: Vec<usize> = (0..10).filter(|key| !ends[*key].is_closed()).collect();
    assert_eq!(going_on, [6, 7, 8, 9], "those that were asked about last");
    assert_eq!(
        jobs.ask(0, |_| async { Ok(8) }).await,
        Ok(8),
        "one that was given up begins anew"
    );
}

#[tokio::test(start_paused = true)]
async fn too_many_jobs_are_refused() {
    let stopping = CancellationToken::new();
    let jobs: Jobs<usize, u64> = Jobs::new("the sum", Duration::ZERO, stopping.clone());
    let waiting: Vec<_> = (0..MOST)
        .map(|key| jobs.join(key, Who::Caller, |_| std::future::pending()).ok())
        .collect();
    let refused = jobs
        .ask(MOST, |_| async { Ok(1) })
        .await
        .expect_err("too many");
    assert_eq!(refused.kind, ErrorKind::Overloaded);
    drop(waiting);
    assert_eq!(
        jobs.ask(MOST, |_| async { Ok(1) }).await,
        Ok(1),
        "those that nobody waits for make room"
    );
    stopping.cancel();
}

/// A job that another one waits for, and that never ends by itself; tells when it is dropped.
fn endless(dropped: oneshot::Sender<()>) -> futures::future::BoxFuture<'static, Made> {
    struct Tells(Option<oneshot::Sender<()>>);
    impl Drop for Tells {
        fn drop(&mut self) {
            let _ = self.0.take().map(|dropped| dropped.send(()));
        }
    }
    let tells = Tells(Some(dropped));
    Box::pin(async move {
        let _tells = tells;
        std::future::pending().await
    })
}

#[tokio::test(start_paused = true)]
async fn what_a_job_waits_for_is_abandoned_with_it() {
    let ((outer, _stopping), (inner, _also)) = (jobs(Duration::ZERO), jobs(Duration::ZERO));
    let (dropped, gone) = oneshot::channel();
    let waited = inner.clone();
    outer.begin("key", |progress| async move {
        waited.ask_for(&progress, "key", |_| endless(dropped)).await
    });
    let began = Instant::now();
    tokio::time::timeout(ABANDONED * 10, gone)
        .await
        .expect("it is given up")
        .expect("told");
    assert_eq!(began.elapsed(), ABANDONED);
}

#[tokio::test(start_paused = true)]
async fn what_a_caller_asks_for_too_is_left_to_it() {
    let ((outer, _stopping), (inner, _also)) = (jobs(Duration::ZERO), jobs(Duration::ZERO));
    let (dropped, mut gone) = oneshot::channel();
    let waited = inner.clone();
    outer.begin("key", |progress| async move {
        waited.ask_for(&progress, "key", |_| endless(dropped)).await
    });
    let began = Instant::now();
    tokio::time::sleep(ABANDONED - CALL).await;
    asked(&inner).await.expect_err("it goes on");
    let left = Instant::now();
    assert!(began.elapsed() < ABANDONED && gone.try_recv().is_err());
    gone.await.expect("told");
    assert_eq!(
        left.elapsed(),
        ABANDONED,
        "two minutes after the last who asked"
    );
}
