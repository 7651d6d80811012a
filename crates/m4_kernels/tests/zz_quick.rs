use m4_kernels::*;
use m4_kernels::reference::{render, backward, Setup, splats_of, BackwardForm};
use m4_kernels::blend::reference::{Hard, CHANNELS};
use m4_testkit::*;
use m4_scene::*;
use m4_math::CounterRng;
#[test]
fn quick() {
  for level in SimdLevel::available() {
   for (case,(w,h)) in [(64,48),(37,53),(5,3),(130,70)].into_iter().enumerate() {
    for iso in [false,true] { for (sh,td) in [(0,0),(1,1),(2,0),(3,2)] { for mip in [false,true] { for extra in [false,true] {
    let seed = case as u64;
    let camera = random_camera(seed, w, h);
    let spec = SceneSpec { layout: SplatLayout{isotropic: iso, sh_degree: sh, time_degree: td}, n_static: 61, n_dynamic: 45, ..SceneSpec::default() };
    let splats = random_splats(seed, &camera, &spec);
    let view = View{camera, t:4.3, background:[0.2,0.4,0.1], near:0.2, mip, period:9.0, with_depth: extra};
    let setup = Setup::<f64>::new(&view);
    let list = splats_of::<f64>(&splats);
    let want = render::<f64, Hard>(&list, &setup);
    let mut r = Renderer::new(level);
    let frame = r.render(&splats, &view).clone();
    let mut worst=0f64; let mut flips=0;
    for p in 0..w*h { for c in 0..3 { let d=(f64::from(frame.rgb[c][p])-want.image.pixels[p][c]).abs(); if d>1e-5 {flips+=1;} worst=worst.max(d);} }
    let mut rng = CounterRng::new(seed,2,0);
    let wts: Vec<[f64;CHANNELS]> = (0..w*h).map(|_| std::array::from_fn(|k| { let v = 2.0*rng.uniform()-1.0; if k>=3 && !extra {0.0} else {f64::from(v as f32)} })).collect();
    let g = backward::<f64,Hard>(&list,&setup,&want,&wts,BackwardForm::BackToFront);
    let pl = |c:usize| wts.iter().map(|x| x[c] as f32).collect::<Vec<f32>>();
    let fg = FrameGradient{rgb:[pl(0),pl(1),pl(2)], depth: if extra {pl(3)} else {vec![]}, alpha: if extra {pl(4)} else {vec![]}};
    let mut out = Gradients::default();
    r.backward(&splats,&fg,&mut out);
    let ns=splats.n_static();
    let nc = out.columns.len();
    let lay=splats.layout();
    let mut line=String::new();
    let mut got=vec![vec![];nc]; let mut exp=vec![vec![];nc];
    let mut tm=0;
    for i in 0..splats.n() { 
       if g.touched[i] != (out.touched[i]==1) {tm+=1;}
       let p = g.splats[i].parameters();
       for (c,v) in p.iter().enumerate() { let col=&out.columns[c]; let k = if c<lay.shared_columns() {i} else {i-ns}; got[c].push(if out.touched[i]==1 {f64::from(col[k])} else {0.0}); exp[c].push(*v);} }
    let mut bad=0f64;
    for c in 0..nc { let a=Agreement::of(&got[c],&exp[c]); bad=bad.max(a.relative_l2); if a.relative_l2>3e-3 { line+=&format!(" c{c}:{:.1e}",a.relative_l2);} }
    let cam: Vec<f64> = out.camera.tau.iter().chain(&out.camera.omega).chain(&out.camera.intrinsics).copied().collect();
    let cg=g.camera.to_camera_gradient();
    let cw: Vec<f64> = cg.tau.iter().chain(&cg.omega).chain(&cg.intrinsics).copied().collect();
    let a=Agreement::of(&cam,&cw);
    let b=Agreement::of(&out.background.map(f64::from), &g.background.map(|v| v));
    let m2: Vec<f64> = out.means2d.iter().flatten().map(|&v| f64::from(v)).collect();
    let m2w: Vec<f64> = g.means2d.iter().flat_map(|v| [v.x,v.y]).collect();
    let m=Agreement::of(&m2,&m2w);
    eprintln!("{level} {w}x{h} iso{iso} sh{sh}/{td} mip{mip} x{extra}: img {worst:.1e} flips {flips} grad {bad:.1e} cam {:.1e} bg {:.1e} m2d {:.1e} touchdiff {tm}{line}", a.relative_l2, b.relative_l2, m.relative_l2);
   }}}}}
  }
}
