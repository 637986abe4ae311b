//! The window's event loop: passes system events to the window's state. Runs on the main thread,
//! which waits only for events and the display.

use super::{
    AppConfig, AppError,
    events::{Events, fields},
    server_connection::{ConnectionState, ServerConnection},
    window_state::{REFRESH, UserEvent, WindowState},
};
use crate::engine::FrameRenderer;
use std::{
    sync::{Arc, atomic::Ordering},
    time::Instant,
};
use winit::{
    application::ApplicationHandler,
    event::{DeviceEvent, DeviceId, ElementState, MouseButton, MouseScrollDelta, WindowEvent},
    event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy},
    window::WindowId,
};

/// Turn per count of the mouse, degrees.
const DEG_PER_COUNT: f64 = 0.1;
/// Pixels of a touch pad that count as a notch of the wheel.
const PX_PER_NOTCH: f64 = 50.0;

/// Opens the window and returns when it is closed.
///
/// # Errors
/// See [`AppError`]. A refusal by the server is shown in the window, and returned once it is
/// closed.
pub fn run(config: AppConfig, renderer: FrameRenderer) -> Result<(), AppError> {
    let events = Events::open(config.events.as_deref())
        .map_err(|source| AppError::Events { path: config.events.clone().unwrap_or_default(), source })?;
    let event_loop = EventLoop::<UserEvent>::with_user_event().build().map_err(|e| AppError::no_display(&e))?;
    let proxy = event_loop.create_proxy();
    let connection = {
        let proxy = proxy.clone();
        // The window may be closed already.
        let changed = move || {
            let _ = proxy.send_event(UserEvent::Other);
        };
        Arc::new(ServerConnection::start(config.connect.clone(), changed).map_err(AppError::Thread)?)
    };
    let mut app = App {
        config,
        renderer: Some(renderer),
        proxy,
        connection,
        events,
        open: None,
        failed: None,
        last_reported: ConnectionState::Connecting { attempt: 1, after: None },
    };
    event_loop.run_app(&mut app).map_err(|e| AppError::no_display(&e))?;
    // The render thread ends before the resources that it uses.
    let walked = app.open.take().map(|mut visit| {
        visit.close(&app.connection, &mut app.events);
        (visit.frame_times.summary(), visit.counts)
    });
    let (walking, counts) = walked.unwrap_or_default();
    app.events.write("closed", fields! { "walking": walking, "counts": counts });
    match (app.failed.take(), app.connection.state()) {
        (Some(e), _) => Err(e),
        (None, ConnectionState::Refused(e)) => Err(e.into()),
        (None, _) => Ok(()),
    }
}

struct App {
    config: AppConfig,
    /// Present until the window is open.
    renderer: Option<FrameRenderer>,
    proxy: EventLoopProxy<UserEvent>,
    connection: Arc<ServerConnection>,
    events: Events,
    open: Option<WindowState>,
    failed: Option<AppError>,
    /// The connection state that was reported last.
    last_reported: ConnectionState,
}

impl ApplicationHandler<UserEvent> for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.open.is_some() {
            return;
        }
        let renderer = self.renderer.take().unwrap_or_default();
        let drawn_by = renderer.gpu().map_or_else(|| "the processor".to_owned(), |g| g.adapter().to_owned());
        match WindowState::open(&self.config, renderer, event_loop, self.connection.clone(), &self.proxy) {
            Ok(open) => {
                let size = open.window.inner_size();
                let adapter = open.adapter().to_owned();
                tracing::info!("drawing on {drawn_by}, showing by {adapter}");
                let seen =
                    fields! { "width": size.width, "height": size.height, "adapter": adapter, "drawn_by": drawn_by };
                self.events.write("window", seen);
                self.open = Some(open);
            }
            Err(e) => {
                self.failed = Some(e);
                event_loop.exit();
            }
        }
    }

    fn user_event(&mut self, _: &ActiveEventLoop, proxy: UserEvent) {
        let state = self.connection.state();
        if state != self.last_reported {
            self.report_connection(&state);
            self.last_reported = state;
        }
        let Some(open) = &mut self.open else { return };
        match proxy {
            UserEvent::Picture => open.take(&self.connection, &mut self.events),
            // A gamepad sends hundreds of events per second, which do not require a redraw.
            UserEvent::Pad => return open.pad(&self.connection, &mut self.events),
            UserEvent::Other => {}
        }
        for outcome in open.screenshots.try_iter().collect::<Vec<_>>() {
            open.shot(outcome, &mut self.events);
        }
        open.window.request_redraw();
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(open) = &mut self.open else { return };
        let seen = open.egui.on_window_event(&open.window, &event);
        // egui requests a redraw after each redraw, which would never end.
        if seen.repaint && !matches!(event, WindowEvent::RedrawRequested) {
            open.repaint_at = Instant::now();
        }
        match event {
            WindowEvent::CloseRequested | WindowEvent::Destroyed => event_loop.exit(),
            WindowEvent::Resized(size) => open.resize(size),
            WindowEvent::Focused(focused) => open.focus(focused, &mut self.events),
            WindowEvent::ModifiersChanged(m) => open.modifiers = m.state(),
            // Keys that were down before the window got the keyboard are ignored.
            WindowEvent::KeyboardInput { event, is_synthetic: true, .. } if event.state == ElementState::Pressed => {}
            WindowEvent::KeyboardInput { event, .. } => {
                let leave = open.key(&event, &self.connection, &mut self.events);
                if leave {
                    event_loop.exit();
                }
            }
            WindowEvent::MouseInput { state: ElementState::Pressed, button: MouseButton::Left, .. } => {
                open.click(&mut self.events);
            }
            // Over the map the wheel zooms.
            WindowEvent::MouseWheel { .. } if open.map.open => {}
            WindowEvent::MouseWheel { delta, .. } => open.render_thread.change_speed(match delta {
                MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
                MouseScrollDelta::PixelDelta(px) => px.y / PX_PER_NOTCH,
            }),
            WindowEvent::RedrawRequested => {
                if let Err(e) = open.redraw(&self.connection, &mut self.events) {
                    self.failed = Some(e.into());
                    event_loop.exit();
                }
            }
            _ => {}
        }
    }

    fn device_event(&mut self, _: &ActiveEventLoop, _: DeviceId, event: DeviceEvent) {
        if let (Some(open), DeviceEvent::MouseMotion { delta: (dx, dy) }) = (&self.open, event)
            && open.captured
        {
            open.turn_by_mouse((dx, dy), DEG_PER_COUNT);
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        if self.config.stop.load(Ordering::Relaxed) {
            event_loop.exit();
        }
        let Some(open) = &mut self.open else { return };
        let now = Instant::now();
        if open.repaint_at <= now {
            open.repaint_at = now + REFRESH;
            open.window.request_redraw();
        }
        event_loop.set_control_flow(ControlFlow::WaitUntil(open.repaint_at));
    }
}

impl App {
    /// Reports a change of the connection state.
    fn report_connection(&mut self, state: &ConnectionState) {
        match state {
            ConnectionState::Connecting { attempt, .. } => {
                self.events.write("connecting", fields! { "attempt": attempt })
            }
            ConnectionState::Up => {
                let scene = self.connection.scene().map(|s| s.index.scene.name.clone()).unwrap_or_default();
                if let Some(open) = &self.open {
                    open.window.set_title(&format!("{scene} - {}", self.config.connect.address()));
                }
                tracing::info!("connected to {}", self.config.connect.address());
                self.events.write("connected", fields! { "scene": scene });
            }
            ConnectionState::Waiting { reason, .. } => {
                tracing::warn!("{reason}; trying again");
                self.events.write("lost", fields! { "reason": reason });
            }
            ConnectionState::Refused(e) => {
                tracing::error!("{e}");
                self.events.write("refused", fields! { "reason": e.to_string() });
            }
        }
    }
}
