//! Access control: token, `Host` and `Origin` of every request.
//!
//! A page of another site can make a browser connect to loopback, and a foreign host name can be pointed here (DNS
//! rebinding). So every request must name this host, the origin of a WebSocket must be this server, and nothing is answered
//! without the token of the printed address.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::net::SocketAddr;

/// The port of HTTP, which browsers leave out of `Host` and `Origin`.
const HTTP: u16 = 80;

/// Token and host names that requests are checked against.
#[derive(Clone, Debug)]
pub(crate) struct Guard {
    token: String,
    /// Accepted `host:port` values.
    names: Vec<String>,
    port: u16,
    /// Whether the server listens on all interfaces: any numeric address with its port is accepted.
    everywhere: bool,
}

impl Guard {
    /// A guard for a listening address, with a new random token.
    pub(crate) fn new(address: SocketAddr) -> Self {
        let port = address.port();
        let mut names = vec![format!("{address}")];
        if address.ip().is_loopback() {
            names.extend([format!("localhost:{port}"), format!("127.0.0.1:{port}"), format!("[::1]:{port}")]);
        }
        Self { token: token(), names, port, everywhere: address.ip().is_unspecified() }
    }

    /// The token, 32 hexadecimal digits.
    pub(crate) fn token(&self) -> &str {
        &self.token
    }

    /// Whether a `Host` header names this server.
    pub(crate) fn host(&self, host: Option<&str>) -> bool {
        let number = |h: &str| self.everywhere && h.parse::<SocketAddr>().is_ok_and(|a| a.port() == self.port);
        let known = |h: &str| self.names.iter().any(|n| n.eq_ignore_ascii_case(h)) || number(h);
        host.is_some_and(|h| known(h) || self.port == HTTP && known(&format!("{h}:{HTTP}")))
    }

    /// Whether an `Origin` header is this server. A missing header is accepted: only browsers send one.
    pub(crate) fn origin(&self, origin: Option<&str>) -> bool {
        match origin {
            None => true,
            Some(o) => o.strip_prefix("http://").is_some_and(|h| self.host(Some(h))),
        }
    }

    /// Whether the token matches, compared in constant time.
    pub(crate) fn knows(&self, token: Option<&str>) -> bool {
        let Some(given) = token.filter(|t| t.len() == self.token.len()) else { return false };
        given.bytes().zip(self.token.bytes()).fold(0, |bad, (a, b)| bad | (a ^ b)) == 0
    }
}

/// 128 random bits as hexadecimal digits. The keys of the standard library's hashers come from the system's random source.
fn token() -> String {
    let word = || {
        let mut hasher = RandomState::new().build_hasher();
        hasher.write_u32(std::process::id());
        if let Ok(now) = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH) {
            hasher.write_u128(now.as_nanos());
        }
        hasher.finish()
    };
    // The second hasher of a thread has the keys of the first plus one, so each word uses a thread of its own.
    let in_thread = || std::thread::spawn(word).join().unwrap_or_else(|_| word());
    format!("{:016x}{:016x}", in_thread(), in_thread())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard() -> Guard {
        Guard::new("127.0.0.1:7007".parse().unwrap())
    }

    #[test]
    fn only_our_names_pass() {
        let guard = guard();
        for good in ["127.0.0.1:7007", "localhost:7007", "LOCALHOST:7007", "[::1]:7007"] {
            assert!(guard.host(Some(good)) && guard.origin(Some(&format!("http://{good}"))), "{good}");
        }
        for bad in ["evil.example:7007", "127.0.0.1:80", "127.0.0.1", "localhost:7007.evil.example", ""] {
            assert!(!guard.host(Some(bad)) && !guard.origin(Some(&format!("http://{bad}"))), "{bad}");
        }
        assert!(!guard.host(None) && !guard.origin(Some("null")) && !guard.origin(Some("https://localhost:7007")));
        assert!(guard.origin(None));
    }

    #[test]
    fn a_server_that_listens_everywhere_goes_by_numbers_not_by_names() {
        let guard = Guard::new("0.0.0.0:7007".parse().unwrap());
        assert!(guard.host(Some("192.168.1.5:7007")) && guard.origin(Some("http://[fe80::1]:7007")));
        for bad in ["192.168.1.5:80", "evil.example:7007", "192.168.1.5", "192.168.1.5.evil.example:7007"] {
            assert!(!guard.host(Some(bad)), "{bad}");
        }
    }

    #[test]
    fn the_port_of_http_may_be_left_out() {
        let here = Guard::new("127.0.0.1:80".parse().unwrap());
        for good in ["127.0.0.1", "localhost", "LOCALHOST", "[::1]", "127.0.0.1:80", "localhost:80"] {
            assert!(here.host(Some(good)) && here.origin(Some(&format!("http://{good}"))), "{good}");
        }
        for bad in ["evil.example", "evil.example:80", "localhost:7007", "localhost:80:80", "192.168.1.5", ""] {
            assert!(!here.host(Some(bad)) && !here.origin(Some(&format!("http://{bad}"))), "{bad}");
        }
        let everywhere = Guard::new("[::]:80".parse().unwrap());
        for good in ["192.168.1.5", "[fe80::1]", "192.168.1.5:80"] {
            assert!(everywhere.host(Some(good)) && everywhere.origin(Some(&format!("http://{good}"))), "{good}");
        }
        for bad in ["evil.example", "192.168.1.5:7007", "192.168.1.5.evil.example"] {
            assert!(!everywhere.host(Some(bad)), "{bad}");
        }
    }

    #[test]
    fn tokens_differ_and_must_match_whole() {
        let (a, b) = (guard(), guard());
        assert_eq!(a.token().len(), 32);
        assert_ne!(a.token(), b.token());
        assert!(a.knows(Some(a.token())));
        for bad in [None, Some(""), Some(&a.token()[1..]), Some(b.token())] {
            assert!(!a.knows(bad));
        }
    }
}
