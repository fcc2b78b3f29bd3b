//! What every page has in common: one file of HTML that opens from disk and asks no network for anything.

use super::base64;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// A whole page: `body` (with its `body` tag's content) under `title`, looking as `style` (CSS) says.
pub fn document(title: &str, style: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width";
                title { (title) }
                style { (PreEscaped(style)) }
            }
            body { (body) }
        }
    }
    .into_string()
}

/// The address of a PNG that is in the page itself.
pub fn png_address(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64(png))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_title_is_text_and_no_markup() {
        let page = document("a<b>&c", "p{}", &html! { p { "x" } });
        assert!(page.starts_with("<!DOCTYPE html><html lang=\"en\">"));
        assert!(page.contains("<title>a&lt;b&gt;&amp;c</title><style>p{}</style>"));
        assert!(page.ends_with("<body><p>x</p></body></html>"));
    }
}
