//! The page of a run in a real browser.

use crate::support::browser::browser;
use crate::support::devtools::Tab;
use crate::support::plates::loaded;
use coseg::progress::{CurvePoint, Event, Progress, Silent};
use coseg::watch::Watched;
use serde_json::json;
use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

/// The picture that the page shows.
const PICTURE: &str = "document.querySelector('iframe:not(.next)').contentWindow.page";
/// Whether the next picture is there, behind it.
const LOADED: &str = "document.querySelector('iframe.next')?.contentWindow.page !== undefined";
const STAGE: &str = "document.getElementById('stage').textContent";
const BACK: &str = "document.getElementById('back').checkVisibility()";

fn watched() -> Watched<Silent> {
    Watched::start(Ipv4Addr::LOCALHOST.into(), "plates", 0.999, Silent).unwrap()
}

/// Where the camera of the picture is.
fn place(tab: &mut Tab) -> String {
    tab.text(&format!(
        "{PICTURE}.fitted.center.map((v) => v.toFixed(6)).join()"
    ))
}

#[test]
fn the_page_follows_the_run_from_its_first_copy_to_its_end() {
    let Some(browser) = browser() else { return };
    let (scene, gaussians, labels, _folder) = loaded();
    let mut watch = watched();
    let mut tab = Tab::visit(&browser, watch.address(), [900, 700]);
    tab.until(&format!("{STAGE} === 'The photos are being read.'"));
    watch.scene(&scene);
    watch.event(&Event::Started {
        stage: "building",
        done: 0,
        iterations: 100,
    });
    watch.gaussians(&gaussians, None);
    tab.until("watch.shown === 1");
    let first = tab.text("document.getElementById('views').selectedOptions[0].textContent");
    assert!(first.ends_with("(held out)"), "{first}");
    assert_eq!(
        tab.value("document.getElementById('photo').naturalWidth"),
        80
    );
    assert_eq!(tab.value(&format!("{PICTURE}.scene.gaussians")), 111);

    // The person turns the view; the next copy is shown from there.
    let before = place(&mut tab);
    assert_eq!(tab.value(BACK), false);
    tab.drag(&[[300.0, 300.0], [340.0, 310.0]], 0);
    let turned = place(&mut tab);
    watch.gaussians(&gaussians, Some(&labels));
    tab.until("watch.shown === 2");
    assert_eq!(place(&mut tab), turned);
    tab.until(BACK);
    tab.value("document.getElementById('back').click()");
    assert_eq!(place(&mut tab), before);
    tab.until(&format!("!{BACK}"));
    tab.value("document.querySelector('[data-mode=labels]').click()");
    assert_eq!(tab.text(&format!("{PICTURE}.mode")), "labels");
    assert_eq!(
        tab.value("document.querySelectorAll('iframe').length"),
        1,
        "the old picture is gone"
    );

    for iteration in [10, 20] {
        let mut point = CurvePoint {
            iteration,
            gaussians: 111,
            ..CurvePoint::default()
        };
        point.held_out.psnr = Some(20.0 + iteration as f64 / 10.0);
        watch.event(&Event::Evaluated(point));
    }
    tab.until("document.querySelector('.chart p')?.textContent === 'PSNR, dB22.00'");
    // Round numbers beside the curve, and the first and the last step below it.
    let numbers = "[...document.querySelectorAll('.chart')[0].querySelectorAll('text')].map((e) => e.textContent).join()";
    assert_eq!(tab.text(numbers), "21,21.5,22,0,20");
    let rows = "document.querySelector('tbody').innerText.replaceAll(/\\s+/g, ' ').trim()";
    watch.event(&Event::Scored {
        variant: "vote",
        miou: None,
    });
    watch.event(&Event::Started {
        stage: "ours",
        done: 0,
        iterations: 40,
    });
    watch.event(&Event::Evaluated(CurvePoint {
        iteration: 20,
        miou: Some(0.5),
        ..CurvePoint::default()
    }));
    tab.until(&format!(
        "{rows} === 'vote \u{2013} in training, 20 steps 50.0'"
    ));
    watch.event(&Event::Finished);
    watch.event(&Event::Scored {
        variant: "ours",
        miou: Some(0.8125),
    });
    tab.until(&format!("{rows} === 'vote \u{2013} ours 81.3'"));

    tab.value("document.getElementById('stop').click()");
    tab.until("document.getElementById('stop').textContent === 'Stopping'");
    // The button says so before the server hears of it.
    let clock = Instant::now();
    while !watch.stop() {
        assert!(clock.elapsed() < Duration::from_secs(20), "not stopped");
        std::thread::sleep(Duration::from_millis(20));
    }
    drop(watch);
    tab.until(&format!("{STAGE}.startsWith('The run has ended.')"));
    assert_eq!(tab.value("watch.shown"), json!(2), "the picture stays");
}

#[test]
fn a_copy_waits_while_the_person_holds_the_picture() {
    let Some(browser) = browser() else { return };
    let (scene, gaussians, _, _folder) = loaded();
    let mut watch = watched();
    let mut tab = Tab::visit(&browser, watch.address(), [900, 700]);
    watch.scene(&scene);
    watch.gaussians(&gaussians, None);
    tab.until("watch.shown === 1");
    let mut copies_wait = |tab: &mut Tab| {
        let shown = tab.value("watch.shown");
        watch.gaussians(&gaussians, None);
        tab.until(LOADED);
        std::thread::sleep(Duration::from_millis(500));
        assert_eq!(tab.value("watch.shown"), shown);
    };

    // A drag goes on, and the next picture has the focus that the click gave the one before.
    tab.hover([300.0, 300.0]);
    tab.press([300.0, 300.0]);
    tab.pull([340.0, 310.0]);
    let turned = place(&mut tab);
    copies_wait(&mut tab);
    tab.pull([380.0, 320.0]);
    let further = place(&mut tab);
    assert_ne!(further, turned);
    tab.release([380.0, 320.0]);
    tab.until("watch.shown === 2");
    assert_eq!(place(&mut tab), further);
    let focus =
        "[document.activeElement.title, document.activeElement.contentDocument?.activeElement.id]";
    assert_eq!(tab.value(focus), json!(["scene", "picture"]));

    // So does a walk.
    for shown in 3..=4 {
        let before = place(&mut tab);
        tab.hold_key("KeyW", 0);
        tab.until(&format!(
            "{PICTURE}.fitted.center.map((v) => v.toFixed(6)).join() !== '{before}'"
        ));
        copies_wait(&mut tab);
        tab.lift_key("KeyW", 0);
        tab.until(&format!("watch.shown === {shown}"));
        assert_eq!(tab.value(focus), json!(["scene", "picture"]));
    }
}

#[test]
fn keys_alone_reach_every_control() {
    let Some(browser) = browser() else { return };
    let (scene, gaussians, labels, _folder) = loaded();
    let mut watch = watched();
    let mut tab = Tab::visit(&browser, watch.address(), [900, 700]);
    watch.scene(&scene);
    watch.gaussians(&gaussians, Some(&labels));
    tab.until("watch.shown === 1");
    let focus = "(() => { const e = document.activeElement; return e.contentDocument?.activeElement.id ?? (e.id || e.textContent); })()";
    tab.key("Tab", 0);
    assert_eq!(tab.text(focus), "picture");
    tab.hold_key("ArrowLeft", 0);
    tab.until(BACK);
    tab.lift_key("ArrowLeft", 0);
    for control in ["stop", "Colour", "Both", "Labels", "views", "back"] {
        tab.key("Tab", 0);
        assert_eq!(tab.text(focus), control);
    }
    tab.key("Enter", 0);
    tab.until(&format!("!{BACK}"));
    assert_eq!(tab.text(focus), "views");
}

#[test]
fn a_run_that_does_not_answer_for_a_while_goes_on() {
    let Some(browser) = browser() else { return };
    let mut watch = watched();
    let mut tab = Tab::visit(&browser, watch.address(), [900, 700]);
    watch.event(&Event::Started {
        stage: "building",
        done: 0,
        iterations: 100,
    });
    let running = format!("{STAGE} === 'building, 0 of 100'");
    tab.until(&running);
    tab.value("window.answered = window.fetch; window.fetch = () => Promise.reject(new Error('asleep')); 1");
    tab.until(&format!("{STAGE}.startsWith('No answer')"));
    let stop = "['hidden', 'disabled'].map((key) => document.getElementById('stop')[key])";
    assert_eq!(tab.value(stop), json!([false, true]));
    tab.value("window.fetch = window.answered; 1");
    tab.until(&running);
    assert_eq!(tab.value(stop), json!([false, false]));
}

#[test]
fn everything_is_large_enough_for_a_finger() {
    let Some(browser) = browser() else { return };
    let (scene, gaussians, labels, _folder) = loaded();
    let mut watch = watched();
    let mut tab = Tab::visit(&browser, watch.address(), [390, 844]);
    tab.resize([390, 844], true);
    watch.scene(&scene);
    watch.gaussians(&gaussians, Some(&labels));
    tab.until("watch.shown === 1");
    let before = place(&mut tab);
    tab.fingers([[150.0, 150.0]], [[210.0, 160.0]]);
    assert_ne!(place(&mut tab), before, "one finger turns the view");
    tab.until(BACK);
    // A tablet is wider than a phone.
    for size in [[390, 844], [1000, 700]] {
        tab.resize(size, true);
        let small = "[...document.querySelectorAll('button, select')].filter((e) => e.checkVisibility()) \
            .map((e) => [e, e.getBoundingClientRect()]).filter(([, box]) => box.width < 44 || box.height < 44) \
            .map(([e, box]) => `${e.id || e.textContent} ${box.width} x ${box.height}`)";
        assert_eq!(tab.value(small), json!([]), "{size:?}");
        let wide = "document.documentElement.scrollWidth > innerWidth || \
            document.querySelector('aside').scrollWidth > document.querySelector('aside').clientWidth";
        assert_eq!(tab.value(wide), false, "{size:?}");
    }
}
