//! A wire that breaks: a TCP proxy whose connections are cut, at random or on demand.

use std::net::SocketAddr;
use std::time::Duration;

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use tokio::io::copy_bidirectional;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// A proxy before one address; it ends when dropped.
pub struct Proxy {
    pub address: String,
    is_up: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Proxy {
    /// Forwards until it is told otherwise, and cuts every connection after a random time where
    /// `cut_after` says how long at most.
    pub async fn start(upstream: SocketAddr, cut_after: Option<Duration>, seed: u64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("bound").to_string();
        let (is_up, told) = watch::channel(true);
        let task = tokio::spawn(accept(
            listener,
            upstream,
            told,
            cut_after,
            StdRng::seed_from_u64(seed),
        ));
        Self {
            address,
            is_up,
            task,
        }
    }

    /// Cuts every connection and refuses new ones, or lets them through again.
    pub fn set_up(&self, is_up: bool) {
        self.is_up.send(is_up).expect("the proxy runs");
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn accept(
    listener: TcpListener,
    upstream: SocketAddr,
    is_up: watch::Receiver<bool>,
    cut_after: Option<Duration>,
    mut rng: StdRng,
) {
    while let Ok((client, _)) = listener.accept().await {
        if *is_up.borrow() {
            let life = cut_after.map(|most| most.mul_f64(rng.random_range(0.1..1.0)));
            tokio::spawn(forward(client, upstream, is_up.clone(), life));
        }
    }
}

async fn forward(
    mut client: TcpStream,
    upstream: SocketAddr,
    mut is_up: watch::Receiver<bool>,
    life: Option<Duration>,
) {
    let Ok(mut server) = TcpStream::connect(upstream).await else {
        return;
    };
    tokio::select! {
        _ = copy_bidirectional(&mut client, &mut server) => {}
        _ = is_up.wait_for(|up| !up) => {}
        () = tokio::time::sleep(life.unwrap_or(Duration::from_secs(3_600))) => {}
    }
}
