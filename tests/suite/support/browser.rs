//! The viewer's page in a browser: what it draws, and what it says after a program has run in it.

use std::path::{Path, PathBuf};
use std::process::Command;

/// PSNR of values that are clamped to 0..1.
pub fn psnr(a: &[f32], b: &[f32]) -> f64 {
    assert_eq!(a.len(), b.len());
    let clamp = |v: &f32| f64::from(v.clamp(0.0, 1.0));
    let squares: f64 = a
        .iter()
        .zip(b)
        .map(|(a, b)| (clamp(a) - clamp(b)).powi(2))
        .sum();
    -10.0 * (squares / a.len() as f64).log10()
}

/// A browser that draws without a screen: the program that COSEG_BROWSER names, or Chromium.
pub fn browser() -> Option<String> {
    let named = std::env::var("COSEG_BROWSER").ok();
    let known = ["chromium", "chromium-browser", "google-chrome"].map(str::to_owned);
    let answers = |name: &String| {
        Command::new(name)
            .arg("--version")
            .output()
            .is_ok_and(|o| o.status.success())
    };
    let found = named.into_iter().chain(known).find(answers);
    if found.is_none() {
        eprintln!("SKIPPED: no Chromium to draw the page; COSEG_BROWSER may name one");
    }
    found
}

/// Runs the browser without a window on the page at `path`, with `#` and `address` behind its name.
fn browse(browser: &str, path: &Path, address: &str, what: &str) -> String {
    let url = format!(
        "file://{}#{address}",
        path.canonicalize().unwrap().display()
    );
    // What a page keeps in the browser must not reach another test.
    let profile = tempfile::tempdir().unwrap();
    let output = Command::new(browser)
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .args([
            "--headless",
            "--no-sandbox",
            "--hide-scrollbars",
            "--force-device-scale-factor=1",
            "--window-size=320,240",
        ])
        .args([
            "--enable-unsafe-swiftshader",
            "--virtual-time-budget=10000",
            what,
            &url,
        ])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).unwrap()
}

/// What the browser draws of the page, a view of this size.
pub fn drawn(browser: &str, path: &Path, address: &str, [width, height]: [usize; 2]) -> Vec<f32> {
    let shot = path.with_extension("png");
    browse(
        browser,
        path,
        &format!("{address}&bare"),
        &format!("--screenshot={}", shot.display()),
    );
    let picture = image::open(&shot)
        .unwrap()
        .crop_imm(0, 0, width as u32, height as u32)
        .to_rgb8();
    assert_eq!(picture.dimensions(), (width as u32, height as u32));
    picture
        .into_raw()
        .into_iter()
        .map(|v| f32::from(v) / 255.0)
        .collect()
}

/// The page with a program at its end, in which it finds `page` and `send`, beside itself.
pub fn scripted(page: &Path, script: &str) -> PathBuf {
    let send = "const send = (type, x, y, more) => document.getElementById('picture').dispatchEvent(\
        new PointerEvent(type, { clientX: x, clientY: y, pointerId: 1, buttons: 1, ...more }));\
        document.getElementById('picture').setPointerCapture = () => {};";
    let text = std::fs::read_to_string(page).unwrap();
    let script = format!(
        "<pre id=\"said\"></pre><script type=\"module\">const page = window.page; {send} {script}</script></body>"
    );
    let scripted = page.with_file_name("scripted.html");
    std::fs::write(&scripted, text.replace("</body>", &script)).unwrap();
    scripted
}

/// The text of the element with this id after `script` has run in the page.
pub fn after(browser: &str, page: &Path, script: &str, id: &str) -> String {
    let dom = browse(browser, &scripted(page, script), "", "--dump-dom");
    let (_, after) = dom.split_once(&format!("id=\"{id}\">")).unwrap();
    after
        .split_once("</pre>")
        .unwrap()
        .0
        .replace("&gt;", ">")
        .replace("&amp;", "&")
}

/// What stands in the element with this id.
pub fn inside<'a>(page: &'a str, id: &str) -> &'a str {
    let (_, after) = page.split_once(&format!("id=\"{id}\">")).unwrap();
    after.split_once("</script>").unwrap().0
}
