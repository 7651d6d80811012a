//! Access control: which requests are allowed, and the security headers of every response.

use super::{ServeError, Shared};
use axum::extract::{Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONNECTION, CONTENT_SECURITY_POLICY, HOST, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// Random bytes of a token: 128 bits cannot be guessed.
const TOKEN_BYTES: usize = 16;

/// The page is one file: nothing is fetched from elsewhere, nothing is sent anywhere but here,
/// nobody frames it. The scripts in it start workers and a WebAssembly module that they carry with
/// them.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline' blob: data:; \
                      style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src 'self' data: blob:; \
                      worker-src blob: data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Host and token that a request must name.
#[derive(Debug)]
pub(super) struct Guard {
    token: String,
    digest: blake3::Hash,
    hosts: Vec<String>,
}

impl Guard {
    /// With a new token, for a server on this port.
    pub fn new(port: u16) -> Result<Self, ServeError> {
        let mut random = [0u8; TOKEN_BYTES];
        getrandom::fill(&mut random).map_err(|e| ServeError::Random(e.to_string()))?;
        let names = ["127.0.0.1", "localhost"];
        let mut hosts: Vec<String> = names.iter().map(|name| format!("{name}:{port}")).collect();
        if port == 80 {
            hosts.extend(names.map(str::to_owned));
        }
        let token: String = random.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self {
            digest: blake3::hash(token.as_bytes()),
            token,
            hosts,
        })
    }

    pub fn token(&self) -> &str {
        &self.token
    }

    /// True for a request to this machine by its name. Another name that was made to point here
    /// (DNS rebinding) belongs to a page of elsewhere.
    fn knows_host(&self, request: &Request) -> bool {
        let mut named = request.headers().get_all(HOST).iter();
        let host = named.next().and_then(|h| h.to_str().ok());
        let authority = request.uri().authority().map(|a| a.as_str());
        let is_own = |name: &str| self.hosts.iter().any(|h| h.eq_ignore_ascii_case(name));
        host.is_some_and(is_own) && named.next().is_none() && authority.is_none_or(is_own)
    }

    /// True if the token is right. Hashes are compared, which takes the same time whatever they
    /// are.
    fn knows_token(&self, request: &Request) -> bool {
        let query_token = query_value(request.uri().query(), "token");
        query_token.is_some_and(|token| blake3::hash(token.as_bytes()) == self.digest)
    }
}

/// The first value of that name in a query. Ours consist of letters and digits, which need no
/// escaping.
pub(super) fn query_value<'a>(query: Option<&'a str>, name: &str) -> Option<&'a str> {
    query?
        .split('&')
        .find_map(|pair| pair.strip_prefix(name)?.strip_prefix('='))
}

/// Lets requests through that name the host and the token.
pub(super) async fn check(State(shared): State<Shared>, request: Request, next: Next) -> Response {
    let refused = if !shared.guard.knows_host(&request) {
        Some("this server answers to 127.0.0.1 alone\n")
    } else if !shared.guard.knows_token(&request) {
        Some("open the address that minute4d printed, with everything behind token=\n")
    } else {
        None
    };
    let mut response = match refused {
        // Kept alive, refused requests could hold all connections.
        Some(why) => (StatusCode::FORBIDDEN, [(CONNECTION, "close")], why).into_response(),
        None => next.run(request).await,
    };
    let fixed: [(HeaderName, &'static str); 6] = [
        (CACHE_CONTROL, "no-store"),
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        // the address holds the token
        (REFERRER_POLICY, "no-referrer"),
        (
            HeaderName::from_static("cross-origin-resource-policy"),
            "same-origin",
        ),
        (
            HeaderName::from_static("cross-origin-opener-policy"),
            "same-origin",
        ),
    ];
    for (name, value) in fixed {
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::{Guard, query_value};
    use axum::body::Body;
    use axum::extract::Request;

    fn request(uri: &str, hosts: &[&str]) -> Request {
        let builder = hosts
            .iter()
            .fold(Request::get(uri), |b, host| b.header("host", *host));
        builder.body(Body::empty()).unwrap()
    }

    #[test]
    fn only_this_machine_is_a_host() {
        let guard = Guard::new(4321).unwrap();
        assert!(guard.knows_host(&request("/", &["127.0.0.1:4321"])));
        assert!(guard.knows_host(&request("/", &["LOCALHOST:4321"])));
        for hosts in [
            &["127.0.0.1"][..],
            &["127.0.0.1:80"],
            &["example.com:4321"],
            &[],
            &["localhost:4321", "evil"],
        ] {
            assert!(!guard.knows_host(&request("/", hosts)), "{hosts:?}");
        }
        assert!(!guard.knows_host(&request("http://evil:4321/", &["127.0.0.1:4321"])));
        assert!(
            Guard::new(80)
                .unwrap()
                .knows_host(&request("/", &["127.0.0.1"]))
        );
    }

    #[test]
    fn tokens_are_long_random_and_compared_whole() {
        let (a, b) = (Guard::new(1).unwrap(), Guard::new(1).unwrap());
        assert!(a.token() != b.token() && a.token().len() == 32);
        let with = |token: &str| request(&format!("/?seen=3&token={token}"), &[]);
        assert!(a.knows_token(&with(a.token())));
        let (short, long) = (&a.token()[..31], format!("{}0", a.token()));
        for wrong in [
            b.token(),
            short,
            &long,
            "",
            &a.token().to_uppercase().replace(char::is_numeric, "x"),
        ] {
            assert!(!a.knows_token(&with(wrong)), "{wrong}");
        }
        assert!(!a.knows_token(&request("/", &[])));
    }

    #[test]
    fn queries_are_taken_by_whole_names() {
        assert_eq!(query_value(Some("a=1&token=x"), "token"), Some("x"));
        assert_eq!(query_value(Some("xtoken=1&token2=2"), "token"), None);
        assert_eq!(query_value(Some("token"), "token"), None);
        assert_eq!(query_value(None, "token"), None);
    }
}
