'use strict';
// Gives every view a slider between two of its images, by pointer or keyboard.
document.documentElement.classList.add('js');
const make = (name, parent, text) => {
  const node = document.createElement(name);
  if (text !== undefined) node.textContent = text;
  return parent.appendChild(node);
};
for (const view of document.querySelectorAll('figure.view')) {
  const box = view.querySelector('.pictures');
  const spans = [...box.querySelectorAll('span:not(.map)')];
  if (spans.length < 2) continue;
  const names = spans.map((span) => span.querySelector('small').textContent);
  const wipe = document.createElement('div');
  wipe.className = 'wipe';
  const stage = make('div', wipe);
  stage.className = 'stage';
  const [under, over] = [0, 1].map((i) => stage.appendChild(spans[i].querySelector('img').cloneNode()));
  over.className = 'over';
  const range = make('input', wipe);
  range.type = 'range';
  range.setAttribute('aria-label', 'Wipe: ' + view.dataset.name);
  const chosen = [0, 1];
  const show = () => {
    stage.style.setProperty('--at', range.value + '%');
    const [left, right] = chosen.map((i) => names[i]);
    range.setAttribute('aria-valuetext', range.value + ' % ' + left + ', the rest ' + right);
  };
  range.addEventListener('input', show);
  const drag = (event) => {
    if (event.type === 'pointermove' && !event.buttons) return;
    const area = stage.getBoundingClientRect();
    range.value = Math.round((100 * (event.clientX - area.left)) / area.width);
    show();
  };
  stage.addEventListener('pointerdown', drag);
  stage.addEventListener('pointermove', drag);
  const sides = make('div', wipe);
  sides.className = 'sides';
  ['left', 'right'].forEach((side, i) => {
    if (names.length === 2) {
      make('small', sides, names[i]);
      return;
    }
    const select = make('select', sides);
    select.setAttribute('aria-label', 'Picture on the ' + side);
    names.forEach((name) => make('option', select, name));
    select.selectedIndex = chosen[i];
    select.addEventListener('change', () => {
      chosen[i] = select.selectedIndex;
      [under, over][i].src = spans[chosen[i]].querySelector('img').src;
      [under, over][i].alt = names[chosen[i]];
      show();
    });
  });
  box.prepend(wipe);
  show();
}
