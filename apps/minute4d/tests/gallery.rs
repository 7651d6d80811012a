//! The page of many scenes.

use crate::common::Scratch;
use serde_json::json;
use std::fs;

/// Writes the files of a scene that a gallery looks at.
fn write_scene(dir: &Scratch, folder: &str, preview: bool) {
    fs::create_dir_all(dir.path(folder)).unwrap();
    dir.write(&format!("{folder}/viewer.html"), "x".repeat(1_500_000));
    let record = json!({"splats": {"static": 40, "dynamic": 2}});
    dir.write(&format!("{folder}/run.json"), record.to_string());
    if preview {
        dir.write(&format!("{folder}/preview.mp4"), "video");
    }
}

#[test]
fn a_gallery_shows_every_scene_and_can_be_moved() {
    let dir = Scratch::new();
    write_scene(&dir, "scenes/2 <dogs> & \"cats\"", true);
    write_scene(&dir, "scenes/holiday/beach", false);
    // No scenes: a hidden folder, what a scene has within, and a folder without a viewer.
    write_scene(&dir, "scenes/.work/half", true);
    write_scene(&dir, "scenes/holiday/beach/capture", true);
    fs::create_dir_all(dir.path("scenes/notes")).unwrap();
    let ended = dir.succeed("gallery scenes --json");
    assert_eq!(ended.result()["scenes"].as_array().unwrap().len(), 2);
    let page = fs::read_to_string(dir.path("scenes/index.html")).unwrap();
    assert!(page.contains("<title>scenes</title>") && page.contains("2 scenes."));
    for part in [
        "<a href=\"2%20%3Cdogs%3E%20%26%20%22cats%22/viewer.html\"><video src=\"2%20%3Cdogs%3E%20%26%20%22cats%22/preview.mp4\"",
        "<h2>2 &lt;dogs&gt; &amp; &quot;cats&quot;</h2><p>42 splats, 1.5 MB</p>",
        "<a href=\"holiday/beach/viewer.html\"><div class=\"none\">",
        "<h2>holiday / beach</h2>",
    ] {
        assert!(page.contains(part), "no {part} in {page}");
    }
    assert!(
        !page.contains("half") && !page.contains("capture"),
        "{page}"
    );
    assert!(!page.contains("http"), "it loads nothing from elsewhere");
    // Again, with one scene less.
    fs::remove_dir_all(dir.path("scenes/holiday")).unwrap();
    dir.succeed("gallery scenes");
    let page = fs::read_to_string(dir.path("scenes/index.html")).unwrap();
    assert!(
        page.contains("1 scene.") && !page.contains("beach"),
        "{page}"
    );
}

#[test]
fn a_page_of_the_users_stays_and_folders_without_scenes_are_named() {
    let dir = Scratch::new();
    write_scene(&dir, "scenes/a", true);
    dir.write("scenes/index.html", "mine");
    dir.refused("gallery scenes", 73, &["index.html"]);
    assert_eq!(
        fs::read_to_string(dir.path("scenes/index.html")).unwrap(),
        "mine"
    );
    fs::create_dir(dir.path("empty")).unwrap();
    dir.refused("gallery empty", 65, &["empty has no scenes", "viewer.html"]);
    dir.refused("gallery nowhere", 66, &["nowhere"]);
}
