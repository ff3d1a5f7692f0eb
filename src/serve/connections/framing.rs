//! The framing of gRPC messages (a flag, four bytes of length, the message), followed as bytes pass
//! by: how much of the message at hand is there?

/// The prefix of a message: a flag and its length.
const PREFIX: usize = 5;

/// Where a stream of messages stands.
#[derive(Debug, Default)]
pub struct Framing {
    prefix: [u8; PREFIX],
    /// Bytes of the message at hand, its prefix included; 0 between messages.
    arrived: usize,
    /// Its whole size, once the prefix is complete.
    size: usize,
}

impl Framing {
    /// Takes note of the next bytes.
    pub fn feed(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            let taken = if self.arrived < PREFIX {
                self.feed_prefix(bytes)
            } else {
                self.feed_message(bytes)
            };
            bytes = &bytes[taken..];
            if self.arrived >= PREFIX && self.arrived == self.size {
                *self = Self::default();
            }
        }
    }

    /// Returns how many bytes of an unfinished message arrived: 0 between messages.
    pub fn unfinished(&self) -> usize {
        self.arrived
    }

    fn feed_prefix(&mut self, bytes: &[u8]) -> usize {
        let taken = bytes.len().min(PREFIX - self.arrived);
        self.prefix[self.arrived..self.arrived + taken].copy_from_slice(&bytes[..taken]);
        self.arrived += taken;
        if self.arrived == PREFIX {
            let [_, length @ ..] = self.prefix;
            self.size = PREFIX + u32::from_be_bytes(length) as usize;
        }
        taken
    }

    fn feed_message(&mut self, bytes: &[u8]) -> usize {
        let taken = bytes.len().min(self.size - self.arrived);
        self.arrived += taken;
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_followed_however_they_are_cut() {
        let message = |length: u8| [vec![0, 0, 0, 0, length], vec![7; length.into()]].concat();
        let bytes = [message(3), message(0), message(200), message(1)].concat();
        let ends = [0, 8, 13, 218, 224];
        for cut in 1..=bytes.len() {
            let mut framing = Framing::default();
            let mut passed = 0;
            for part in bytes.chunks(cut) {
                framing.feed(part);
                passed += part.len();
                let begun = ends
                    .iter()
                    .rev()
                    .find(|end| **end <= passed)
                    .expect("0 is among them");
                assert_eq!(
                    framing.unfinished(),
                    passed - begun,
                    "{cut} at a time, {passed} passed"
                );
            }
        }
    }
}
