// The slider over the steps: play, pause, step, jump from link to link, and its keys.

import {element, icon, kIcons} from './format.js';

const kSpeeds = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000];  // steps per second
const kPlaySeconds = 20;  // about how long a whole run takes at first

export const kKeys = [
  ['Space', 'play or pause'], ['← →', 'a step back or forth'], ['Shift ← →', 'ten steps'], ['N P', 'next or previous step that accepts a link'],
  ['Home End', 'first or last step'], ['V', '3D or from above'], ['D', 'light or dark'],
  ['in the map', 'arrow keys turn, + and − zoom, 0 shows all'],
];

export class Timeline {
  // `events`: ascending positions at which a link is accepted. `onStep(position)` is called when the position changes from
  // that of the start.
  constructor(node, count, events, start, onStep) {
    Object.assign(this, {count, events, onStep, position: start, playing: false, label: () => ['', '']});
    const button = (name, label, action) => element('button', {type: 'button', class: 'icon-button', 'data-button': name, 'aria-label': label, title: label, onclick: action}, icon(kIcons[name]));
    this.playButton = button('play', 'Play', () => this.toggle());
    this.playButton.classList.add('play');
    this.slider = element('input', {type: 'range', id: 'slider', min: 0, max: count - 1, step: 1, value: start, 'aria-label': 'Step of the run',
      oninput: () => this.jump(Number(this.slider.value))});
    const wanted = kSpeeds.find((speed) => count / speed <= kPlaySeconds) ?? kSpeeds[kSpeeds.length - 1];
    this.speed = element('select', {'aria-label': 'Speed', title: 'Steps per second'}, kSpeeds.map((speed) =>
      element('option', {value: speed, selected: speed === wanted}, `${speed}/s`)));
    this.readout = element('output', {class: 'readout', for: 'slider'});
    this.extra = element('span', {class: 'player-extra'});
    node.append(
      element('div', {class: 'player-buttons', role: 'group', 'aria-label': 'Replay'},
        button('first', 'First step', () => this.jump(0)),
        button('linkBack', 'Previous step that accepts a link', () => this.toLink(-1)),
        button('back', 'Step back', () => this.move(-1)), this.playButton, button('forward', 'Step forth', () => this.move(1)),
        button('linkForward', 'Next step that accepts a link', () => this.toLink(1)),
        button('last', 'Last step', () => this.jump(this.count - 1))),
      this.slider, this.readout, this.speed, this.extra);
    document.addEventListener('keydown', (event) => this.key(event));
  }

  // Says where the slider stands; to be called when the meaning of a position changes, too.
  refresh() {
    this.slider.value = this.position;
    this.slider.style.setProperty('--share', `${this.count > 1 ? (100 * this.position) / (this.count - 1) : 100}%`);
    const [text, more] = this.label(this.position);
    this.readout.replaceChildren(text, element('span', {class: 'readout-more'}, more));
    this.slider.setAttribute('aria-valuetext', text + more);
  }

  set(position) {
    const next = Math.min(Math.max(Math.round(position), 0), this.count - 1);
    if (next === this.position) return;
    this.position = next;
    this.refresh();
    this.onStep(next);
  }

  jump(position) {
    this.pause();
    this.set(position);
  }

  move(by) { this.jump(this.position + by); }

  toLink(direction) {
    const next = direction > 0 ? this.events.find((at) => at > this.position) : this.events.filter((at) => at < this.position).pop();
    if (next !== undefined) this.jump(next);
  }

  toggle() { this.playing ? this.pause() : this.play(); }

  play() {
    if (this.position >= this.count - 1) this.set(0);
    this.playing = true;
    this.showPlaying();
    let last = performance.now(), exact = this.position;
    const tick = (now) => {
      if (!this.playing) return;
      exact += (Math.max(now - last, 0) / 1000) * Number(this.speed.value);
      last = now;
      this.set(Math.floor(exact));
      if (this.position >= this.count - 1) this.pause();
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  pause() {
    this.playing = false;
    this.showPlaying();
  }

  showPlaying() {
    const label = this.playing ? 'Pause' : 'Play';
    this.playButton.replaceChildren(icon(this.playing ? kIcons.pause : kIcons.play));
    this.playButton.setAttribute('aria-label', label);
    this.playButton.title = label;
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    const {target} = event;
    if (target.closest?.('select, textarea, input:not([type=range]):not([type=checkbox])')) return;
    const isSlider = target === this.slider;
    if (target.type === 'range' && !isSlider) return;
    if (event.key === ' ' && target.closest?.('button, summary, input[type=checkbox]')) return;
    const by = event.shiftKey ? 10 : 1;
    const actions = {
      ' ': () => this.toggle(), ArrowLeft: () => this.move(-by), ArrowRight: () => this.move(by), n: () => this.toLink(1), p: () => this.toLink(-1),
      Home: () => this.jump(0), End: () => this.jump(this.count - 1),
    };
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    action();
    event.preventDefault();
  }
}
